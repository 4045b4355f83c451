"""What the worker's compiled loop calls: take the frames that came, send the next one (``docs/write-a-driver.md``).

Only whole frames of the messages in the configuration that follow each other without a gap are dealt with, as
``FrameSearch`` would have found them. Anything else stays in the buffer for Python, with what came behind it: garbage,
a wrong checksum, another kind, a frame that stands still or in which another one may begin.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver import Compiler, now_ns
from micromanip.driver.byte_stream import ask, read_bytes, write_bytes
from micromanip.driver.datagrams import (
    GOOD,
    OLD,
    begin_frame,
    code_of,
    judged,
    leave_samples,
    missing_before,
    put_value,
    seal,
)
from micromanip.driver.steady import NOTHING_SENT, SENT_IN_DOUBT, UNCONFIRMED, steady_entries

from .frame_reader import STALE_NS
from .records import CONTEXT, MAX_CHUNKS, READ_BYTES

compiled = Compiler(__file__)
_MORE, _ODD = -1, -2
"""Of what is there from some byte on: it may become a frame; it is for Python to judge."""
_WOULD_BLOCK = 11


@compiled
def has_sync(c: Any, at: int) -> bool:
    """Whether the sync bytes are in the buffer from byte `at` on, as far as it is filled."""
    differs = 0
    for i in range(min(c["sync_bytes"], c["filled"] - at)):
        differs |= c["buffer"][at + i] ^ c["sync"][i]
    return differs == 0


@compiled
def message_at(c: Any, at: int) -> int:
    """Number of the message whose frame is whole in the buffer from byte `at` on; _MORE, _ODD."""
    there, sync_bytes = c["filled"] - at, c["sync_bytes"]
    if not has_sync(c, at):
        return _ODD
    if there < c["header_bytes"]:
        return _MORE
    data = c["frame"]
    for i in range(min(there, c["longest"])):
        data[i] = c["buffer"][at + i]
    number = _ODD
    for m in range(c["received_messages"]):
        if c["kind"]["present"] == 0 or c["received"][m]["kind"] == code_of(c["kind"], data):
            number = m
    if number < 0:
        return _ODD
    f = c["received"][number]["frame"]
    length = f["length"]
    if c["length"]["present"] != 0 and np.int64(code_of(c["length"], data)) + c["plus"] != length:
        return _ODD
    if there < length:
        return _MORE
    if judged(f, data, length) != GOOD:
        return _ODD
    for i in range(1, length):  # another one may begin inside of it, and be the real one
        if at + i + sync_bytes <= c["filled"] and has_sync(c, at + i):
            return _ODD
    if f["checksum"]["size"] == 0 and not has_sync(c, at + length):
        return _ODD
    return number


@compiled
def take_message(c: Any, number: int, inbox: Any, time_ns: int) -> None:
    """The frame that was looked at last, of message `number`, as samples, if it is a fresh one."""
    m = c["received"][number]
    f, samples, missing = m["frame"], m["samples"], 0
    if f["counter"]["present"] != 0:
        count: Any = np.int64(code_of(f["counter"], c["frame"]) & np.uint64(0xFFFFFFFF))
        by_sample = m["by_sample"] != 0
        missing = missing_before(c["received"][m["counted"]]["counter"], count, samples if by_sample else 1)
        if missing == OLD:
            return
        missing = max(missing, 0)
        if not by_sample:
            c["more_lost"] += missing * (samples - 1)
            missing *= samples
    signals, lost = inbox["signal"][m["input"] :], inbox["missing"][m["input"] :]
    # the newest wins, as in the loop's image: those before it are counted
    leave_samples(c["samples"], f, c["frame"], signals, lost, missing, time_ns, samples - 1)
    inbox["received"] += samples * f["numbers"]
    inbox["lost"] += missing * f["numbers"]
    c["frames"] += 1
    c["heard_ns"] = time_ns
    for k in range(c["sent_messages"]):
        if c["sent"][k]["unheard"] != 0:  # a device that acknowledges nothing has it, as far as anybody can tell
            c["sent"][k]["unheard"], inbox["confirmed"][k] = 0, 1


@compiled
def drop(c: Any, count: int) -> None:
    """Forget the first so many bytes of the buffer."""
    for i in range(count, c["filled"]):
        c["buffer"][i - count] = c["buffer"][i]
    c["filled"] -= count
    kept = 0
    for k in range(c["chunks"]):
        if c["chunk_end"][k] > count:
            c["chunk_end"][kept], c["chunk_ns"][kept] = c["chunk_end"][k] - count, c["chunk_ns"][k]
            kept += 1
    c["chunks"] = kept


@compiled
def take_frames(c: Any, inbox: Any, time_ns: int) -> bool:
    """Take all whole frames from the beginning of the buffer; False where what follows is for Python to judge."""
    at = 0
    number = _MORE
    while at < c["filled"]:
        number = message_at(c, at)
        if number < 0:
            break
        take_message(c, number, inbox, time_ns)
        at += c["received"][number]["frame"]["length"]
    drop(c, at)
    goes_on: bool = c["filled"] == 0 or number == _MORE
    return goes_on


@compiled
def needs_python(c: Any) -> bool:
    """Whether something is left that Python has to deal with before anything else."""
    left: bool = c["left"] != 0 or c["unsent"] != 0 or c["receive_error"] != 0 or c["send_error"] != 0
    return left


@compiled
def take(c: Any, inbox: Any, began_ns: int) -> int:  # noqa: ARG001
    """Take what is there, a reading at most; 0, or 1 where Python has to judge, or the device is silent too long."""
    if needs_python(c):
        return 1
    if c["chunks"] == MAX_CHUNKS:
        c["left"] = 1
        return 1
    count = read_bytes(c["descriptor"], c["buffer"].ctypes.data + c["filled"], READ_BYTES)
    time_ns = now_ns(c["timespec"])
    if count == 0:
        c["left"] = 1  # the other end is gone, which Python finds too
    elif count > 0:
        k = c["chunks"]
        c["bytes_in"] += count
        c["filled"] += count
        c["chunk_end"][k], c["chunk_ns"][k], c["chunks"] = c["filled"], time_ns, k + 1
        if not take_frames(c, inbox, time_ns):
            c["left"] = 1
    elif count != -_WOULD_BLOCK:
        c["receive_error"] = -count
    elif c["chunks"] > 0 and time_ns - c["chunk_ns"][c["chunks"] - 1] > STALE_NS:
        c["left"] = 1
    is_silent = c["silence_ns"] > 0 and time_ns - c["heard_ns"] > c["silence_ns"]
    return 1 if needs_python(c) or is_silent else 0


@compiled
def give(c: Any, values: Any, task: int) -> int:
    """Send the message of `task` with `values` of all outputs of the driver; what the worker's loop is told."""
    if needs_python(c):
        return NOTHING_SENT
    m, data = c["sent"][task], c["frame"]
    f = m["frame"]
    length = f["length"]
    begin_frame(f, data, m["count"])
    for j in range(f["numbers"]):
        if not put_value(f, f["number"][j], data, values[m["output"] + j]):
            return NOTHING_SENT
    seal(f, data)
    if ask(c["descriptor"], c["waiting_request"], c["waiting"].ctypes.data) < 0 or c["waiting"][0] >= length:
        return NOTHING_SENT
    count = write_bytes(c["descriptor"], data.ctypes.data, length)
    if count == -_WOULD_BLOCK:
        return NOTHING_SENT
    if count < 0:
        c["send_error"] = -count
        return SENT_IN_DOUBT
    c["frame_bytes"], c["unsent"] = length, length - count
    c["bytes_out"] += length
    m["count"] += 1
    if c["received_messages"] == 0 or f["numbers"] == 0:
        return 0
    m["unheard"] = 1
    return UNCONFIRMED


ENTRIES = steady_entries(compiled, CONTEXT, take, give)
