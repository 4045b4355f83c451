"""The gate of ``bus/safe_state.py`` for outputs that follow the loop, or rest: the same values, decided without Python.

What changes their state (a dead loop, one that asks for rest) is not for here: then Python has its turn.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.bus_exchange import begin_turn, end_turn
from micromanip.rt.bus_image import OUTPUT_TURN, SENT_NS, SENT_TURN, TRIES, WRITTEN_NS
from micromanip.rt.intrinsics import fence, load_acquire, store_release
from micromanip.rt.jit import compiled
from micromanip.rt.record import Record
from micromanip.rt.slot import sealed
from micromanip.rt.wire.byte_stream import write_at

from .records import UNUSED, VOLTAGE

_EQUAL_V = 1e-9
_sealed = compiled(sealed)


@compiled
def take_wanted(st: Record, image: Record) -> None:
    """What the loop wants, and when it wrote that; as before where it is just writing."""
    words = image["words"]
    for _ in range(TRIES):
        turn = load_acquire(words, OUTPUT_TURN)
        if turn & 1 != 0:
            continue
        for i in range(st["outputs"]):
            st["value"][i] = image["value"][i]  # no more than scratch: it is decided anew after this
        written_ns = load_acquire(words, WRITTEN_NS)
        fence()
        if load_acquire(words, OUTPUT_TURN) == turn:
            for i in range(st["outputs"]):
                st["wanted"][i] = st["value"][i]
            st["written_ns"] = written_ns
            return


@compiled
def state_holds(st: Record, now_ns: int) -> bool:
    """Whether the outputs go on following the loop, or resting; else Python decides what is next."""
    dead = now_ns - st["written_ns"] > st["dead_ns"]
    if st["following"] != 0:
        return not dead
    return dead or not asks_for_rest(st)


@compiled
def asks_for_rest(st: Record) -> bool:
    """Whether the loop wants the safe values of all voltages."""
    for i in range(st["outputs"]):
        o = st["output"][i]
        if o["kind"] == VOLTAGE and not abs(st["wanted"][i] - o["safe"]) <= _EQUAL_V:
            return False
    return True


@compiled
def decide(st: Record) -> None:
    """What the device is to be given next."""
    for i in range(st["outputs"]):
        o, wanted = st["output"][i], st["wanted"][i]
        value = o["last"]
        if st["following"] == 0 or o["kind"] == UNUSED:
            value = o["safe"]
        elif math.isfinite(wanted) and o["low"] <= wanted <= o["high"]:
            value = wanted
        else:
            st["refused"] += 1
        if o["kind"] == VOLTAGE:
            near = min(max(value, o["highest"] - o["step"]), o["lowest"] + o["step"])
            value = min(max(near, o["low"]), o["high"])
        st["value"][i] = value


@compiled
def rests(st: Record) -> bool:
    """Whether the device has the safe value of every voltage, and what was decided leaves it there."""
    for i in range(st["outputs"]):
        o = st["output"][i]
        furthest = max(abs(o["lowest"] - o["safe"]), abs(o["highest"] - o["safe"]), abs(st["value"][i] - o["safe"]))
        if o["kind"] == VOLTAGE and not furthest <= _EQUAL_V:
            return False
    return True


@compiled
def was_silent(st: Record, task: int, now_ns: int) -> bool:
    """Whether the device's watchdog may have led an output of `task` away from what it was given."""
    t = st["task"][task]
    if now_ns - t["fed_ns"] <= st["begins_ns"]:
        return False
    for j in range(t["outputs"]):
        o = st["output"][t["output"][j]]
        furthest = max(abs(o["lowest"] - o["rest"]), abs(o["highest"] - o["rest"]))
        if o["kind"] == VOLTAGE and not furthest <= o["step"] + _EQUAL_V:
            return True
    return False


@compiled
def note_turn(st: Record, image: Record, task: int, now_ns: int) -> None:
    """The outputs of `task` have had their turn."""
    t = st["task"][task]
    for j in range(t["outputs"]):
        store_release(image["turned_ns"], t["output"][j], now_ns)


@compiled
def note_sent(st: Record, task: int, now_ns: int) -> None:
    """The device may have what was decided of the outputs of `task`: it has not confirmed that yet."""
    t = st["task"][task]
    t["unconfirmed"], t["sent_ns"] = 1, now_ns
    for i in range(st["outputs"]):
        t["sent"][i] = st["value"][i]
    for j in range(t["outputs"]):
        i = t["output"][j]
        o, value = st["output"][i], st["value"][i]
        o["lowest"], o["highest"] = min(o["lowest"], value), max(o["highest"], value)


@compiled
def note_given(
    st: Record, image: Record, slot: Any, values: Any, task: int, given: Any, fed_ns: int, now_ns: int
) -> None:
    """The device has taken the outputs of `task` as `given`, one for each output, sent at `fed_ns`: image and file
    remember that.
    """
    t = st["task"][task]
    t["fed_ns"] = fed_ns
    t["given"] += 1
    if t["outputs"] == 0:
        return
    for j in range(t["outputs"]):
        i = t["output"][j]
        o, value = st["output"][i], given[i]
        o["last"], o["lowest"], o["highest"], st["noted"][i] = value, value, value, value
    words = image["words"]
    begin_turn(words, SENT_TURN)
    for i in range(st["outputs"]):
        image["sent"][i] = st["noted"][i]
    words[SENT_NS] = now_ns
    end_turn(words, SENT_TURN)
    if slot.size > 0:
        remember(st, slot, values)


@compiled
def take_confirmed(st: Record, image: Record, inbox: Record, slot: Any, values: Any, now: int) -> None:
    """What the device has taken, as it was sent before."""
    for k in range(st["tasks"]):
        if inbox["confirmed"][k] == 0:
            continue
        inbox["confirmed"][k] = 0
        t = st["task"][k]
        if t["unconfirmed"] != 0:
            t["unconfirmed"] = 0
            note_given(st, image, slot, values, k, t["sent"], t["sent_ns"], now)


@compiled
def remember(st: Record, slot: Any, values: Any) -> None:
    """Write the slot whose turn it is, as ``bus/last_given.py`` does and reads it.

    `slot` and `values` are the same memory, one slot of the file.
    """
    st["memory_turn"] += 1
    slot[0] = st["memory_turn"]
    for i in range(st["outputs"]):
        values[1 + i] = st["noted"][i]
    slot[len(slot) - 1] = _sealed(slot, st["memory_seed"])
    write_at(st["memory_file"], slot, st["memory_place"][st["memory_turn"] % 2])
