"""The driver in the loop: judge the frame that came back, look after the line, send the next one.

The frame of one cycle is taken in the next, or waited for (decisions 0075, 0077). It comes back through all slaves:
with the working counter of all, and all in OP, it is the acknowledgement that they have its outputs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver import entries, now_ns
from micromanip.driver.datagrams import (
    GOOD,
    NOT_OPEN,
    WRONG_LENGTH,
    acknowledge,
    begin,
    bits_at,
    close,
    code_of,
    end,
    hear_clock,
    judged,
    leave_samples,
    length_of,
    missing_before,
    on_link_lost,
    received_ns,
    rest,
    send_due,
    steer,
    take,
    taken_ns,
    turn,
    wait_for_answer,
)
from micromanip.driver.ethercat import OP, STATUS_BYTES, STATUS_MASK, WKC_BYTES
from micromanip.driver.wire import FOLLOWING, RECENT

from .records import CONTEXT, compiled
from .ring import send_at_far_end, take_half, take_ring

_TIME_BYTES = 8


@compiled
def take_one(c: Any, k: int, inputs: Any, deadline_ns: int) -> int:
    """Frame `k` of the socket: 1 if it acknowledges what was sent."""
    s = c["socket"]
    return take_frame(c, s["received"][k], length_of(s, k), received_ns(s, k), inputs, deadline_ns)


@compiled
def take_one_of_ring(c: Any, s: Any, k: int, end: int, inputs: Any, deadline_ns: int) -> int:
    """Frame `k` of the socket at an end of a ring: 1 if with it something is acknowledged."""
    data = s["received"][k]
    return take_half(c, data, length_of(s, k), received_ns(s, k), end, take_good, inputs, deadline_ns)


@compiled
def take_frame(c: Any, data: Any, length: int, came_ns: int, inputs: Any, deadline_ns: int) -> int:
    """A frame that came: 1 if it acknowledges what was sent. Only a complete one, fresh, becomes samples."""
    f = c["receive"]
    c["received"] += 1
    verdict = judged(f, data, length)
    if verdict != GOOD:
        if verdict == WRONG_LENGTH:
            c["wrong_length"] += 1
        else:
            c["not_this_frame"] += 1
        return 0
    return take_good(c, data, came_ns, inputs, deadline_ns)


@compiled.called  # built in wherever frames are taken, it and ``take_all`` were half of all that was compiled
def take_good(c: Any, data: Any, came_ns: int, inputs: Any, deadline_ns: int) -> int:
    """One of ours, which came at `came_ns`."""
    f, g = c["receive"], c["gate"]
    count = int(code_of(f["counter"], data))
    if c["lock"]["present"] != 0:
        hear_first_clock(c, data, count, came_ns)
    missing = missing_before(c["counted"], count)
    if missing < 0:
        return 0
    behind = (g["sent_count"] - 1 - count) % c["counts"]
    c["answered"] = g["sent_count"] - behind
    if behind != 0:
        c["delayed"] += 1
    broadcast = np.int64(bits_at(data, c["status_at"] + STATUS_BYTES, WKC_BYTES, 0))
    complete = np.int64(bits_at(data, c["working_counter_at"], WKC_BYTES, 0)) == c["working_counter"]
    if broadcast != c["terminals"] or not complete:
        c["wrong_working_counter"] += 1
    c["al_status"] = np.int64(bits_at(data, c["status_at"], STATUS_BYTES, 0)) & STATUS_MASK
    if c["al_status"] != OP:
        c["not_operating"] += 1
        c["unusable"] = 0
        on_link_lost(g)  # a slave has left OP, and leads its outputs by itself
        return 0
    missing += c["unusable"]
    c["unusable"] = missing + 1
    if broadcast != c["terminals"] or not complete:
        return 0
    c["unusable"] = 0
    at_ns = came_ns
    if f["clock"]["present"] != 0:
        at_ns = taken_ns(c["clock"], code_of(f["clock"], data), came_ns)
    leave_samples(c["samples"], f, data, inputs, c["samples"]["lost"], missing, min(at_ns, deadline_ns))
    return acknowledge(g, behind)


@compiled
def hear_first_clock(c: Any, data: Any, count: int, came_ns: int) -> None:
    """What a frame says of the first terminal's clock, where that has been read, and it is known when it was sent."""
    g, at = c["gate"], c["time_at"]
    behind = (g["sent_count"] - 1 - count) % c["counts"]
    if behind < RECENT and bits_at(data, at + _TIME_BYTES, WKC_BYTES, 0) > 0:
        stamp_ns: Any = np.int64(bits_at(data, at, _TIME_BYTES, 0))
        hear_clock(c["lock"], c["lock"]["sent_ns"][count % RECENT], stamp_ns, came_ns - c["turn_ns"])


@compiled
def follow_clock(c: Any, deadline_ns: int, periods: int) -> None:
    """Steer the next deadline; the outputs follow only while it is locked."""
    g, lock = c["gate"], c["lock"]
    steer(lock, deadline_ns, periods, g["silent_cycles"])
    g["held"] = 1 - lock["locked"]
    if g["held"] != 0 and g["state"] == FOLLOWING:
        on_link_lost(g)


@compiled
def exchange(c: Any, outputs: Any, inputs: Any, deadline_ns: int, periods: int) -> int:
    """One exchange of the loop; what ``turn`` says, or NOT_OPEN.

    What passed unseen matters to the clock only: silence is counted in what was sent in vain.
    """
    if c["opened"] == 0:
        return NOT_OPEN
    news = c["news"] + take_all(c, inputs, deadline_ns)
    if c["lock"]["present"] != 0:
        follow_clock(c, deadline_ns, periods)
    code = turn(c["gate"], news, outputs, deadline_ns)
    c["news"] = 0
    if c["lock"]["present"] != 0:
        c["lock"]["sent_ns"][c["gate"]["sent_count"] % RECENT] = now_ns(c["socket"]["timespec"])
    send_all(c, code, outputs, deadline_ns)
    wait_for_answer(c, take_all, inputs, deadline_ns)
    return code


@compiled.called
def take_all(c: Any, inputs: Any, deadline_ns: int) -> int:
    """What has come since the last time, of a line or a ring; how many frames acknowledge what was sent."""
    if c["ring"]["present"] != 0:
        return take_ring(c, take_one_of_ring, inputs, deadline_ns)
    return take(c, take_one, inputs, deadline_ns)


@compiled
def send_all(c: Any, code: int, outputs: Any, deadline_ns: int) -> None:
    """``send_due``, in a ring at both ends."""
    sent, not_sent = c["gate"]["sent_count"], c["not_sent"]
    send_due(c, code, outputs, deadline_ns)
    if c["ring"]["present"] != 0 and (c["gate"]["sent_count"] != sent or c["not_sent"] != not_sent):
        send_at_far_end(c, c["gate"]["sent_count"] == sent)


@compiled
def let_go(c: Any) -> int:
    """Of all sockets."""
    if c["ring"]["present"] != 0:
        close(c["ring"]["socket"])
    return end(c)


ENTRIES = entries(compiled, CONTEXT, begin, exchange, rest, let_go)
