"""The loop's side of a process image: outputs left for the worker, what has come taken, and whether the link is up."""

from __future__ import annotations

import math
from typing import Any

from . import bus_image as im
from .intrinsics import fence, load_acquire, store_release
from .jit import compiled
from .record import Record


@compiled
def begin_turn(words: Any, index: int) -> None:
    """Make the turn number odd, visible before any of the payload that is written next."""
    store_release(words, index, words[index] | 1)
    fence()


@compiled
def end_turn(words: Any, index: int) -> None:
    """After a payload has been written."""
    store_release(words, index, words[index] + 1)


@compiled
def leave_outputs(c: Record, outputs: Any, now_ns: int) -> None:
    """The loop leaves its `outputs`, decided at `now_ns`."""
    begin_turn(c["words"], im.OUTPUT_TURN)
    for i in range(c["outputs"]):
        c["value"][i] = outputs[i]
    c["words"][im.WRITTEN_NS] = now_ns
    end_turn(c["words"], im.OUTPUT_TURN)


@compiled
def take_inputs(c: Record, inputs: Any, now_ns: int) -> None:
    """The loop takes what has come; a sample taken after `now_ns`, this cycle's deadline, counts as taken then."""
    for i in range(c["inputs"]):
        for _ in range(im.TRIES):
            turn = load_acquire(c["input_turn"], i)
            if turn & 1 != 0:
                continue
            source = c["input"][i]
            value, time_ns = source["value"], source["time_ns"]
            sequence, status, missing = source["sequence"], source["status"], c["missing"][i]
            fence()
            if load_acquire(c["input_turn"], i) == turn:
                if inputs[i]["sequence"] == 0:
                    c["missing_before"][i] = missing
                inputs[i]["value"], inputs[i]["time_ns"] = value, min(time_ns, now_ns)
                inputs[i]["sequence"], inputs[i]["status"] = sequence, status
                break


@compiled
def link_is_up(c: Record, now_ns: int) -> bool:
    """Whether the link was up without a break since the cycle before, and its worker is alive.

    The worker's silence counts only while the loop itself ran: a stall of the machine may have stopped both. A pause
    counts as half of the allowed silence, however long it was.
    """
    words, alive_ns = c["words"], load_acquire(c["words"], im.ALIVE_NS)
    pause_ns = min(now_ns - words[im.LOOKED_NS], c["silent_ns"] // 2)
    words[im.SILENT_NS] = words[im.SILENT_NS] + pause_ns if alive_ns == words[im.ALIVE_SEEN] else 0
    words[im.LOOKED_NS], words[im.ALIVE_SEEN] = now_ns, alive_ns
    up = load_acquire(words, im.LINK) == im.LINK_UP and words[im.SILENT_NS] <= c["silent_ns"]
    epoch = load_acquire(words, im.EPOCH)
    same = epoch == words[im.EPOCH_SEEN]
    words[im.EPOCH_SEEN] = epoch
    return up and same


@compiled
def put_back(c: Record, outputs: Any, now_ns: int) -> None:
    """Replace the `outputs` whose turn is overdue by what the device was given: they have to wait.

    No turn number guards this: during a turn both values are true.
    """
    for i in range(c["outputs"]):
        given = c["sent"][i]
        if now_ns - load_acquire(c["turned_ns"], i) > c["patience_ns"][i] and math.isfinite(given):
            outputs[i] = given


@compiled
def exchange_image(c: Record, outputs: Any, inputs: Any, now_ns: int) -> int:
    """One exchange of the loop with a bus; 0, DOWN, TAKEN, or AWAY."""
    leave_outputs(c, outputs, now_ns)
    take_inputs(c, inputs, now_ns)
    if not link_is_up(c, now_ns):
        return im.DOWN
    if c["outputs"] == 0:
        return 0
    if load_acquire(c["words"], im.OUTPUT_STATE) != im.FOLLOWING:
        return im.TAKEN
    put_back(c, outputs, now_ns)
    return 0 if load_acquire(c["words"], im.AT_REST) != 0 else im.AWAY
