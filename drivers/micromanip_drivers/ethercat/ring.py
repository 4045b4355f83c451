"""A ring of terminals in the loop: each frame is sent at both its ends, and terminals act on it once.

Where the ring is whole, all of them act on what came in at the near end, which leaves at the far one; what came in at
the far end goes by behind them as it is. Where it is cut, each half turns back at the cut and comes to the end that it
was sent from, with the working counter of its terminals: both together are the frame. So nothing has to be noticed, or
switched over, before a cycle is complete again. Each half reads the clock of the terminal that it acts on first, and
tells the others: the time of a frame is that of the near half, the first terminal's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver.datagrams import (
    GOOD,
    bits_at,
    code_of,
    has_sent,
    judged,
    receive,
    send,
)
from micromanip.driver.ethercat import PROCESSED, STATUS_BYTES, WKC_BYTES

from .link import FAR_BIT, LAST_OF_SENDER, LOOP_SENDERS, SENDER
from .records import WHOLE, compiled

_NEAR, _FAR = 0, 1
_NEAR_SENDER = LOOP_SENDERS[_NEAR][-1]


@compiled
def take_ring(c: Any, take_one: Any, inputs: Any, deadline_ns: int) -> int:
    """Take in what has come at both ends, a batch of each; how many frames acknowledge what was sent.

    ``take_one(c, s, k, end, inputs, deadline_ns)`` judges what is in place `k` of the socket at an end.
    """
    news = take_end(c, c["socket"], _NEAR, take_one, inputs, deadline_ns)
    return news + take_end(c, c["ring"]["socket"], _FAR, take_one, inputs, deadline_ns)


@compiled
def take_end(c: Any, s: Any, end: int, take_one: Any, inputs: Any, deadline_ns: int) -> int:
    """The same of one end."""
    news = 0
    for k in range(receive(s)):
        news += take_one(c, s, k, end, inputs, deadline_ns)
    return news


@compiled
def take_half(
    c: Any, data: Any, length: int, came_ns: int, end: int, take_good: Any, inputs: Any, deadline_ns: int
) -> int:
    """A frame that came at an end: taken at once where all terminals have acted on it, else with its other half.

    ``take_good(c, data, came_ns, inputs, deadline_ns)`` gets what is a whole frame then.
    """
    ring, f = c["ring"], c["receive"]
    c["received"] += 1
    if length != f["length"]:
        c["wrong_length"] += 1
        return 0
    if data[SENDER] & PROCESSED == 0:
        return 0
    sent_at = _FAR if data[LAST_OF_SENDER] & FAR_BIT != 0 else _NEAR
    reached: Any = np.int64(bits_at(data, c["status_at"] + STATUS_BYTES, WKC_BYTES, 0))
    if not is_good(c, data, reached):
        c["not_this_frame"] += 1
        return 0
    if reached == c["terminals"]:
        behind = 0 if sent_at == _FAR else WHOLE if end == _FAR else c["terminals"]
        note_cut(ring, behind)
        c["turn_ns"] = ring["way_ns"] if behind == WHOLE else 0
        return take_good(c, data, came_ns, inputs, deadline_ns)  # type: ignore[no-any-return]
    half, other = ring["half"][sent_at], ring["half"][1 - sent_at]
    half["count"], half["reached"] = np.int64(code_of(f["counter"], data)), reached
    for i in range(length):
        half["data"][i] = data[i]
    if other["count"] != half["count"]:
        return 0
    merge(c, ring["half"][_NEAR], ring["half"][_FAR])
    c["turn_ns"] = 0  # at least, which is all that is known of a half
    return take_good(c, ring["half"][_NEAR]["data"], came_ns, inputs, deadline_ns)  # type: ignore[no-any-return]


@compiled
def is_good(c: Any, data: Any, reached: int) -> bool:
    """Whether it is a frame of ours that `reached` terminals have counted: then it looks as if all of them had.

    Its sender becomes that of the near end.
    """
    f, ring = c["receive"], c["ring"]
    for at in (ring["position_at"], ring["clock_position_at"]):
        if at != 0:
            if np.int64(bits_at(data, at, 2, 0)) != reached:
                return False
            data[at], data[at + 1] = c["terminals"], 0
    data[LAST_OF_SENDER] = _NEAR_SENDER
    return judged(f, data, f["length"]) == GOOD


@compiled
def merge(c: Any, near: Any, far: Any) -> None:
    """Both halves of a frame into that of the near end: inputs of each terminal from where it was reached."""
    ring, image_end, status = c["ring"], c["working_counter_at"], c["status_at"]
    if near["reached"] + far["reached"] == c["terminals"]:
        note_cut(ring, near["reached"])
    first = ring["inputs_at"][min(near["reached"], c["terminals"])]
    for i in range(first, image_end):
        near["data"][i] = far["data"][i]
    for i in range(status, status + STATUS_BYTES):
        near["data"][i] |= far["data"][i]
    add(near["data"], far["data"], image_end)
    add(near["data"], far["data"], status + STATUS_BYTES)
    near["count"] = far["count"] = -1


@compiled
def add(data: Any, other: Any, at: int) -> None:
    """Two working counters at a place; each is of some tens at most, but for rubbish, which may wrap."""
    total = np.int64(bits_at(data, at, WKC_BYTES, 0)) + np.int64(bits_at(other, at, WKC_BYTES, 0))
    data[at], data[at + 1] = np.uint8(total & 0xFF), np.uint8((total >> 8) & 0xFF)


@compiled
def note_cut(ring: Any, behind: int) -> None:
    """The ring is cut behind so many terminals, or WHOLE."""
    if behind != WHOLE and ring["cut_behind"] == WHOLE:
        ring["cuts"] += 1
    ring["cut_behind"] = behind


@compiled
def send_at_far_end(c: Any, near_failed: bool) -> None:
    """What was just sent at the near end, or what the system did not take there, at the far one too."""
    s, sent, length = c["ring"]["socket"], c["socket"]["sent"], c["send"]["length"]
    for i in range(length):
        s["sent"][i] = sent[i]
    s["sent"][LAST_OF_SENDER] |= FAR_BIT
    if send(s, length) == 0 and near_failed:
        has_sent(c["gate"])
