"""The process image of one bus: what its worker process and the loop tell each other, in shared memory.

The worker publishes each input when it has come, the loop takes all of them once per cycle; the loop leaves the outputs
of every cycle, the worker takes the newest when it is about to write. Neither waits for the other. Each side's
payload is guarded by a turn number that is odd while it is being written: a reader that meets an odd or a changed
one tries again, a bounded number of times, and otherwise keeps what it had.

    word           written by   says
    OUTPUT_TURN    loop         turn of the outputs
    WRITTEN_NS     loop         when the loop wrote them: its sign of life
    LINK           worker       where the link stands, see LINK_NAMES
    EPOCH          worker       grows by one each time the link has come up: what was before is over
    ALIVE_NS       worker       its sign of life
    SENT_TURN      worker       turn of the values that the device was given last
    SENT_NS        worker       when it was given those
    OUTPUT_STATE   worker       whether the outputs follow the loop, see OUTPUT_NAMES
    AT_REST        worker       1 where the device has taken the safe value of every voltage, and is given no other next
    EPOCH_SEEN     loop         newest epoch that the loop has met
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import types

from .intrinsics import fence, load_acquire, store_release
from .jit import compiled
from .records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL, Record

OUTPUT_TURN, WRITTEN_NS, LINK, EPOCH, ALIVE_NS, SENT_TURN, SENT_NS, OUTPUT_STATE, EPOCH_SEEN, AT_REST = range(10)
_WORDS = 16

LINK_DOWN, LINK_UP, LINK_LATCHED = range(3)
LINK_NAMES = ("down", "up", "latched")
"""Not reached, in use, or given up until somebody has looked at it."""

RESTING, FOLLOWING, SAFE_RAMP, UNKNOWN = range(4)
OUTPUT_NAMES = ("at rest", "following", "ramping to rest", "unknown")
"""The device was given the safe values, is given what the loop decides, is on the way to the safe values, or can't be
reached: then nobody knows."""

DOWN, TAKEN, AWAY = -1, -2, -3
"""What ``exchange_image`` returns while the link can't be used, while the outputs do not follow the loop, and while
they follow it and the device is not known to be at rest."""
_TRIES = 4

IMAGE = np.dtype(
    [
        ("words", "i8", (_WORDS,)),
        ("inputs", "i8"),
        ("outputs", "i8"),
        ("silent_ns", "i8"),
        ("timespec", "i8", (2,)),
        ("value", "f8", (MAX_OUTPUTS,)),
        ("sent", "f8", (MAX_OUTPUTS,)),
        ("input_turn", "i8", (MAX_SIGNALS,)),
        ("input", SIGNAL, (MAX_SIGNALS,)),
    ],
    align=True,
)
"""``inputs`` and ``outputs`` are how many there are; a worker silent for longer than ``silent_ns`` is lost. ``value``
is what the loop wants, ``sent`` what the device was given last; NaN where it was not given anything yet."""

IMAGES = types.Array(numba.from_dtype(IMAGE), 1, "C")
VALUES = types.float64[::1]


@compiled
def begin_turn(words: Any, index: int) -> None:
    """Before a payload is written: its turn is odd, and seen to be so before any of the payload."""
    store_release(words, index, words[index] | 1)
    fence()


@compiled
def end_turn(words: Any, index: int) -> None:
    """After a payload has been written."""
    store_release(words, index, words[index] + 1)


@compiled
def leave_outputs(c: Record, outputs: Any, now_ns: int) -> None:
    """The loop leaves its `outputs`, decided at `now_ns`."""
    begin_turn(c["words"], OUTPUT_TURN)
    for i in range(c["outputs"]):
        c["value"][i] = outputs[i]
    c["words"][WRITTEN_NS] = now_ns
    end_turn(c["words"], OUTPUT_TURN)


@compiled
def take_inputs(c: Record, inputs: Any, now_ns: int) -> None:
    """The loop takes what has come; a sample taken after `now_ns`, this cycle's deadline, counts as taken then."""
    for i in range(c["inputs"]):
        for _ in range(_TRIES):
            turn = load_acquire(c["input_turn"], i)
            if turn & 1 != 0:
                continue
            source = c["input"][i]
            value, time_ns = source["value"], source["time_ns"]
            sequence, status = source["sequence"], source["status"]
            fence()
            if load_acquire(c["input_turn"], i) == turn:
                inputs[i]["value"], inputs[i]["time_ns"] = value, min(time_ns, now_ns)
                inputs[i]["sequence"], inputs[i]["status"] = sequence, status
                break


@compiled
def link_is_up(c: Record, now_ns: int) -> bool:
    """Whether the link was up without a break since the cycle before, and its worker is alive."""
    words = c["words"]
    up = load_acquire(words, LINK) == LINK_UP and now_ns - load_acquire(words, ALIVE_NS) <= c["silent_ns"]
    epoch = load_acquire(words, EPOCH)
    same = epoch == words[EPOCH_SEEN]
    words[EPOCH_SEEN] = epoch
    return up and same


@compiled
def exchange_image(c: Record, outputs: Any, inputs: Any, now_ns: int) -> int:
    """One exchange of the loop with a bus; 0, DOWN, TAKEN, or AWAY."""
    leave_outputs(c, outputs, now_ns)
    take_inputs(c, inputs, now_ns)
    if not link_is_up(c, now_ns):
        return DOWN
    if c["outputs"] == 0:
        return 0
    if load_acquire(c["words"], OUTPUT_STATE) != FOLLOWING:
        return TAKEN
    return 0 if load_acquire(c["words"], AT_REST) != 0 else AWAY


@compiled
def publish_one(c: Record, channel: int, value: float, time_ns: int, status: int, lost: int) -> None:
    """A fresh sample of one input."""
    begin_turn(c["input_turn"], channel)
    signal = c["input"][channel]
    signal["value"], signal["time_ns"], signal["status"] = value, time_ns, status
    signal["sequence"] += 1 + lost
    end_turn(c["input_turn"], channel)


@compiled.entry(types.void(IMAGES, types.int64, types.float64, types.int64, types.int64, types.int64))
def publish(image: Any, channel: int, value: float, time_ns: int, status: int, lost: int) -> None:
    """The worker publishes a fresh sample, before which `lost` are missing."""
    publish_one(image[0], channel, value, time_ns, status, lost)


@compiled.entry(types.void(IMAGES, types.int64, types.int64, VALUES, types.int64, types.int64, types.int64))
def publish_all(image: Any, first: int, count: int, values: Any, time_ns: int, status: int, lost: int) -> None:
    """The worker publishes `count` samples of one moment, of the inputs from `first` on."""
    for i in range(count):
        publish_one(image[0], first + i, values[i], time_ns, status, lost)


@compiled.entry(types.int64(IMAGES, VALUES))
def take_outputs(image: Any, values: Any) -> int:
    """The worker takes the newest outputs; when the loop wrote them, or -1 where it is just writing (`values` stay)."""
    c = image[0]
    for _ in range(_TRIES):
        turn = load_acquire(c["words"], OUTPUT_TURN)
        if turn & 1 != 0:
            continue
        written_ns = c["words"][WRITTEN_NS]
        for i in range(c["outputs"]):
            values[i] = c["value"][i]
        fence()
        if load_acquire(c["words"], OUTPUT_TURN) == turn:
            return written_ns
    return -1


@compiled.entry(types.void(IMAGES, VALUES, types.int64))
def remember_sent(image: Any, values: Any, now_ns: int) -> None:
    """The worker notes what the device was given: it is where a worker that takes its place begins."""
    c = image[0]
    begin_turn(c["words"], SENT_TURN)
    for i in range(c["outputs"]):
        c["sent"][i] = values[i]
    c["words"][SENT_NS] = now_ns
    end_turn(c["words"], SENT_TURN)


@compiled.entry(types.void(IMAGES, types.int64, types.int64))
def tell(image: Any, word: int, value: int) -> None:
    """The worker says something about itself, after all that it published before."""
    store_release(image[0]["words"], word, value)


@compiled.entry(types.int64(IMAGES, types.int64))
def ask(image: Any, word: int) -> int:
    """One word, read before everything that follows."""
    return load_acquire(image[0]["words"], word)


@compiled.entry(types.void(IMAGES))
def take_over(image: Any) -> None:
    """A worker begins where another one may have died in the middle of a turn: what that one was writing is dropped.

    The sample that was half written keeps its sequence, so that the loop does not take it for a fresh one; it is marked
    as bad.
    """
    c = image[0]
    for i in range(c["inputs"]):
        if c["input_turn"][i] & 1 != 0:
            c["input"][i]["status"] = DOWN
            end_turn(c["input_turn"], i)
    if c["words"][SENT_TURN] & 1 != 0:
        end_turn(c["words"], SENT_TURN)
