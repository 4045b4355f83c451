"""What the worker's compiled loop calls: take the frames that came, send the next one (``docs/write-a-driver.md``).

The packets are the kernel's ``struct can_frame`` and ``struct canfd_frame``, on the test bus after a time stamp. Only
plain frames are dealt with: anything else waits for Python (``receive`` and ``perform`` of the driver).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver import now_ns
from micromanip.driver.datagrams import BATCH, OLD, length_of, missing_before, receive, received_ns, send
from micromanip.driver.steady import NOTHING_SENT, SENT_IN_DOUBT, steady_entries

from .bit_codec import code_bits, put_value, value_of
from .records import CONTEXT, compiled

_HEADER_BYTES, _CLASSIC_BYTES, _FD_BYTES = 8, 16, 72
_NOT_PLAIN = 0x60000000
"""The flags of an error frame and of a remote frame."""
_IDENTIFIER = 0x9FFFFFFF
"""The identifier, with the flag that it has 29 bits."""
_BAD_STATUS, GONE = -1, -1
_BATCHES = 4
"""Of frames, that are taken at a time: what more there is waits until what is due has been sent."""
_FULL = (11, 12, 105)
"""EAGAIN, ENOMEM, ENOBUFS: the frame was not taken."""


@compiled
def word_of(data: Any, first: int) -> int:
    """The number of 4 bytes that a packet begins with."""
    word: Any = 0
    for j in range(4):
        word |= np.int64(data[first + j]) << (8 * j)
    return word


@compiled
def stamp_of(data: Any) -> int:
    """The time that the test bus puts before a frame."""
    stamp: Any = 0
    for j in range(8):
        stamp |= np.int64(data[j]) << (8 * j)
    return stamp


@compiled
def put_stamp(data: Any, stamp: int) -> None:
    """Put the time before a frame for the test bus."""
    for j in range(8):
        data[j] = np.uint8((stamp >> (8 * j)) & 255)


@compiled
def received_message(c: Any, word: int) -> int:
    """Number of the message with that identifier among those that are received; -1 for none."""
    found = -1
    for m in range(c["received_messages"]):
        if c["received"][m]["word"] == word:
            found = m
    return found


@compiled
def is_watched(c: Any, word: int) -> bool:
    """Whether frames with that identifier are for Python to judge."""
    found = 0
    for m in range(c["watched_words"]):
        found |= c["watched"][m] == word
    return found != 0


@compiled
def take_frame(c: Any, k: int, leave: Any, inbox: Any, time_ns: int) -> bool:
    """Frame `k` of the batch, received at `time_ns`; False for one that is for Python to judge.

    One that is received goes to ``leave(c, number, data, first, inbox, time_ns)``: of which message, the packet, where
    its data begin.
    """
    data, first = c["socket"]["received"][k], c["stamp_bytes"]
    size = length_of(c["socket"], k) - first
    if size != _CLASSIC_BYTES and size != _FD_BYTES:
        return False
    if size == _FD_BYTES and c["fd"] == 0:
        return True  # whoever has not opened the bus for CAN FD does not see its frames
    word, length = word_of(data, first), np.int64(data[first + 4])
    if word & _NOT_PLAIN != 0 or length > size - _HEADER_BYTES:
        return False
    number = received_message(c, word & _IDENTIFIER)
    if number < 0:
        if is_watched(c, word & _IDENTIFIER):
            return False
        c["not_ours"] += 1
        c["frames_in"] += 1
        return True
    m = c["received"][number]
    if length < m["length"]:
        return False
    c["frames_in"] += 1
    c["heard_ns"] = c["socket"]["now_ns"]
    leave(c, number, data, first + _HEADER_BYTES, inbox, time_ns)
    return True


@compiled
def leave_samples(c: Any, number: int, data: Any, first: int, inbox: Any, time_ns: int) -> None:
    """A frame of the message of that number as samples, if it is a fresh one."""
    m = c["received"][number]
    missing, status = 0, 0
    if m["counted"] != 0:
        count: Any = np.int64(code_bits(m["counter_field"], data, first, m["length"]) & np.uint64(0xFFFFFFFF))
        missing = missing_before(m["counter"], count)
        if missing == OLD:
            return
    if m["judged"] != 0:
        status = status_of(c, m, data, first)
    put_samples(c, m, data, first, inbox, time_ns - m["latency_ns"], status, max(missing, 0))


@compiled
def put_samples(c: Any, m: Any, data: Any, first: int, inbox: Any, taken_ns: int, status: int, missing: int) -> None:
    """The signals of message `m` as samples that were taken at `taken_ns`, with so many missing before them."""
    for j in range(m["fields"]):
        signal = inbox["signal"][m["input"] + j]
        signal["value"] = value_of(c["field"][m["field"] + j], data, first, m["length"], c["bits"])
        signal["time_ns"], signal["status"] = taken_ns, status
        signal["sequence"] += 1 + missing
        inbox["missing"][m["input"] + j] += missing
    inbox["received"] += m["fields"]
    inbox["lost"] += missing * m["fields"]


@compiled
def status_of(c: Any, m: Any, data: Any, first: int) -> int:
    """0, or the device's word for what is wrong."""
    word = code_bits(m["status_field"], data, first, m["length"])
    for j in range(m["goods"]):
        if word == m["good"][j]:
            return 0
    c["bits"][0] = word
    found = int(c["bits"].view(np.int64)[0])
    return found if found != 0 else _BAD_STATUS


@compiled
def needs_python(c: Any) -> bool:
    """Whether something is left that Python has to deal with before anything else."""
    left: bool = c["left"] != 0 or c["receive_error"] != 0 or c["send_error"] != 0
    return left


@compiled
def take_all(c: Any, leave: Any, inbox: Any, began_ns: int) -> int:
    """Take what is there, some batches at most: when its newest frame came, `began_ns` for none, or GONE.

    See ``take_frame`` for `leave`. Python has to judge where it is GONE, or ``needs_python``.
    """
    if needs_python(c):
        return GONE
    s, newest_ns = c["socket"], began_ns
    for _ in range(_BATCHES):
        count = receive(s)
        if count < 0:
            c["receive_error"] = -count
            return GONE
        for k in range(count):
            newest_ns = min(stamp_of(s["received"][k]), s["now_ns"]) if c["stamp_bytes"] != 0 else received_ns(s, k)
            if length_of(s, k) == 0:
                return GONE  # the other end is, which Python finds too
            c["odd"][k], c["odd_ns"][k] = 0, newest_ns
            if not take_frame(c, k, leave, inbox, newest_ns):
                c["odd"][k] = 1
                c["left"] += 1
        if count < BATCH or c["left"] != 0:
            break
    return newest_ns


@compiled
def take(c: Any, inbox: Any, began_ns: int) -> int:
    """Take what is there; 0, or 1 where Python has to judge, or the devices are silent too long.

    Silence is judged where a call began: what came while this process stood still is there with the first call after.
    """
    heard_ns = c["heard_ns"]
    if take_all(c, leave_samples, inbox, began_ns) == GONE or needs_python(c):
        return 1
    is_silent = c["silence_ns"] > 0 and began_ns - c["heard_ns"] > c["silence_ns"]
    return 1 if heard_ns == c["heard_ns"] and is_silent else 0


@compiled
def give(c: Any, values: Any, task: int) -> int:
    """Send the message of `task` with `values` of all outputs of the driver; 0, NOTHING_SENT, SENT_IN_DOUBT."""
    m, s = c["sent"][task], c["socket"]
    if needs_python(c):
        return NOTHING_SENT
    packet, before, length = s["sent"], c["stamp_bytes"], m["length"]
    for j in range(m["bytes"]):
        packet[before + j] = m["packet"][j]
    first = before + _HEADER_BYTES
    for j in range(m["fields"]):
        field = c["field"][m["field"] + j]
        if not put_value(field, packet, first, length, values[m["output"] + j], c["bits"]):
            return NOTHING_SENT
    if m["counted"] != 0 and not put_value(m["counter_field"], packet, first, length, float(m["count"]), c["bits"]):
        return NOTHING_SENT
    if before != 0:
        put_stamp(packet, now_ns(s["timespec"]))
    error = send(s, before + m["bytes"])
    if error == 0:
        m["count"] = (m["count"] + 1) % m["counts"]
        c["frames_out"] += 1
        return 0
    for full in _FULL:
        if error == full:
            return NOTHING_SENT  # Python tries once more, and says so
    c["send_error"] = error
    return SENT_IN_DOUBT


ENTRIES = steady_entries(compiled, CONTEXT, take, give)
