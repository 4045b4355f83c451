"""The gate: every value on its way to a device passes it.

    FOLLOWING   the device is given what the loop decides
    SAFE_RAMP   smoothly to the safe values, from what the device was given last
    RESTING     the device was given the safe values; until the loop itself asks for just these: then nothing jumps

The values that the device may have of an output lie between ``lowest`` and ``highest``; the next value is in range and
within a step of all of them, whatever was lost. The clock decides only whether the loop is alive, and whether the
device was silent for so long that it may have gone to rest by itself. The ramp advances with each value that the device
was given, by one period, and rest is reached when the device was given the safe values
(``docs/decisions/0017-bus-workers.md``).

All state is in one record of arrays: a Python worker runs these functions on its ``fields``, a compiled worker
(``worker_loop.py``) runs their machine code on the same record, so that either can continue. The gate of a wire in the
loop (``link_gate.py``) shares the definitions above ``GATE``.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.bus_image import FOLLOWING, RESTING, SAFE_RAMP
from micromanip.rt.jit import compiled
from micromanip.rt.laws.move import minimum_jerk
from micromanip.rt.record import arrays, record
from micromanip.rt.records import MAX_OUTPUTS

MAX_TASKS = 64

VOLTAGE, SWITCH, LAST_SWITCH, UNUSED = range(4)
"""Kinds of output: goes on the ramp; to its safe value at once; when all voltages are at rest; always there."""
EQUAL_V = 1e-9

HELD = (
    *arrays("i8", 1, "outputs"),
    *arrays("i8", MAX_OUTPUTS, "kind"),
    *arrays("f8", MAX_OUTPUTS, "safe", "step", "last", "lowest", "highest"),
)
"""Fields of every gate: of so many outputs, by how much two values that the device gets one after the other may differ
(``step``), what it was given ``last``, and between which bounds lies what it has."""


@compiled
def within_step(g: Any, i: int, value: float) -> float:
    """The value nearest to `value` within a step of all that the device may have."""
    step = g["step"][i]
    return min(max(value, g["highest"][i] - step), g["lowest"][i] + step)


@compiled
def widen(g: Any, i: int, value: float) -> None:
    """Count `value` among what the device may have."""
    if value < g["lowest"][i]:
        g["lowest"][i] = value
    if value > g["highest"][i]:
        g["highest"][i] = value


@compiled
def settle(g: Any, i: int, value: float) -> None:
    """The device has `value` for sure."""
    g["lowest"][i] = g["highest"][i] = value


@compiled
def furthest(g: Any, i: int, value: float) -> float:
    """Largest possible distance of the device from `value`."""
    return max(abs(g["lowest"][i] - value), abs(g["highest"][i] - value))


@compiled
def asks_for_rest(g: Any, wanted: Any) -> bool:
    """Whether the loop asks for the safe value of every voltage."""
    for i in range(g["outputs"][0]):
        if g["kind"][i] == VOLTAGE and not abs(wanted[i] - g["safe"][i]) <= EQUAL_V:
            return False
    return True


GATE = record(
    *HELD,
    *arrays("i8", 1, "state", "dead_ns", "begins_ns", "written_ns", "decided_ns", "touched_ns", "refused"),
    *arrays("f8", 1, "ramp_s"),
    *arrays("f8", MAX_OUTPUTS, "low", "high", "rest", "period_s", "start", "share", "wanted", "value"),
    *arrays("f8", MAX_OUTPUTS, "register_low", "register_high"),
    *arrays("i8", MAX_OUTPUTS, "task", "known", "given"),
    *arrays("i8", MAX_TASKS, "sent_ns", "unconfirmed", "fed_ns", "still"),
    ("sent", "f8", (MAX_TASKS, MAX_OUTPUTS)),
)
"""The gate of a bus' worker. A loop that has written nothing for ``dead_ns`` is dead; after ``begins_ns`` of silence
the device may have begun to go to ``rest`` by itself. Each output lies in ``low`` to ``high`` and is written by the
task number ``task``; it is ``known`` where anybody ever said what it has, ``given`` where the device took it since it
left the loop's hand, and on the ramp a ``share`` of the way from ``start``. The loop ``wanted`` that, and wrote it at
``written_ns``; ``value`` was decided of it at ``decided_ns``, and ``refused`` values were not finite or out of range.
Its register holds what lies from ``register_low`` to ``register_high``, wherever the output went by itself; the
former is above the latter where nothing was sent.

Of each task the values ``sent`` last, at ``sent_ns``, and whether the device has still to confirm them; what it took
last was sent at ``fed_ns``, 0 for nothing: its watchdog's time runs from there, or later. ``still`` tasks have sent
nothing since the device was found at rest. It may have had a command at ``touched_ns``, at the latest."""


@compiled
def decide(g: Any, now_ns: int) -> None:
    """What the device is to be given next, and whether it follows the loop."""
    state = g["state"]
    dead = now_ns - g["written_ns"][0] > g["dead_ns"][0]
    if dead and state[0] == FOLLOWING:
        leave(g)
    if state[0] == RESTING and not dead and asks_for_rest(g, g["wanted"]):
        state[0] = FOLLOWING
    moves = state[0] == SAFE_RAMP and away(g, VOLTAGE) > 0
    for i in range(g["outputs"][0]):
        value = followed(g, i) if state[0] == FOLLOWING else on_the_way(g, i, moves)
        if g["kind"][i] == VOLTAGE:
            value = min(max(within_step(g, i, value), g["low"][i]), g["high"][i])
        g["value"][i] = value
    g["decided_ns"][0] = now_ns


@compiled
def followed(g: Any, i: int) -> float:
    """The loop's value of an output; the value before if it is invalid."""
    wanted = g["wanted"][i]
    if g["kind"][i] == UNUSED:
        return g["safe"][i]
    if math.isfinite(wanted) and g["low"][i] <= wanted <= g["high"][i]:
        return wanted
    g["refused"][0] += 1
    return g["last"][i]


@compiled
def on_the_way(g: Any, i: int, moves: bool) -> float:
    """The next value on the ramp: a period further than what the device was given last; then the safe value."""
    safe, kind = g["safe"][i], g["kind"][i]
    if g["state"][0] == SAFE_RAMP and kind == VOLTAGE:
        share = g["share"][i] + g["period_s"][i] / g["ramp_s"][0]
        return g["start"][i] + minimum_jerk(share) * (safe - g["start"][i])
    return g["last"][i] if moves and kind == LAST_SWITCH else safe


@compiled
def away(g: Any, kind: int) -> int:
    """How many outputs up to this kind are not at rest."""
    count = 0
    for i in range(g["outputs"][0]):
        if g["kind"][i] <= kind and not rests_at(g, i):
            count += 1
    return count


@compiled
def leave(g: Any) -> None:
    """The device no longer follows the loop, and is not known to be at rest."""
    for i in range(g["outputs"][0]):
        if g["state"][0] != SAFE_RAMP:
            g["start"][i], g["share"][i] = g["last"][i], 0.0
        g["given"][i] = 0
    g["state"][0] = SAFE_RAMP
    rest_if_given(g)


@compiled
def rests_at(g: Any, i: int) -> bool:
    """Whether the last value that the device was given since it followed the loop is the safe value."""
    return g["kind"][i] == UNUSED or (g["given"][i] != 0 and furthest(g, i, g["safe"][i]) <= EQUAL_V)


@compiled
def rest_if_given(g: Any) -> None:
    """End the ramp when every output has arrived."""
    if g["state"][0] == SAFE_RAMP and away(g, UNUSED) == 0:
        g["state"][0] = RESTING


@compiled
def rests(g: Any) -> bool:
    """Whether the device is known to have the safe value of every voltage, and what was decided leaves it there."""
    return asks_for_rest(g, g["value"]) and away(g, VOLTAGE) == 0


@compiled
def known_last(g: Any, i: int) -> float:
    """The value that the device was given last; NaN if unknown."""
    return g["last"][i] if g["known"][i] != 0 else math.nan


@compiled
def is_near_rest(g: Any, i: int) -> bool:
    """Whether an output makes no step where the device's own watchdog leads it."""
    near = g["known"][i] != 0 and furthest(g, i, g["rest"][i]) <= g["step"][i] + EQUAL_V
    return g["kind"][i] != VOLTAGE or near


@compiled
def was_silent(g: Any, task: int, now_ns: int) -> bool:
    """Whether the device has had no values of `task` for so long that its watchdog may have begun."""
    return now_ns - g["fed_ns"][task] > g["begins_ns"][0]


@compiled
def may_have_moved(g: Any, task: int, now_ns: int) -> bool:
    """Whether the device's watchdog may have led an output of `task` away from what it was given."""
    if g["still"][task] != 0 or not was_silent(g, task, now_ns):
        return False
    moved = 0
    for i in range(g["outputs"][0]):
        if g["task"][i] == task and not is_near_rest(g, i):
            moved += 1
    return moved > 0


@compiled
def note_sent(g: Any, task: int, began_ns: int, now_ns: int) -> None:
    """The device may have what was decided of the outputs of `task`, sent from `began_ns` on; it is to confirm that."""
    for i in range(g["outputs"][0]):
        if g["task"][i] == task:
            g["sent"][task, i] = value = g["value"][i]
            widen(g, i, value)
            g["register_low"][i] = min(g["register_low"][i], value)
            g["register_high"][i] = max(g["register_high"][i], value)
    g["unconfirmed"][task], g["still"][task] = 1, 0
    g["sent_ns"][task], g["touched_ns"][0] = began_ns, now_ns


@compiled
def note_taken(g: Any, task: int, now_ns: int) -> bool:
    """The device has taken the last values of `task`, as far as its protocol can tell; False: that is no news."""
    if g["unconfirmed"][task] == 0:
        return False
    for i in range(g["outputs"][0]):
        if g["task"][i] == task:
            give(g, i, g["sent"][task, i])
    g["unconfirmed"][task] = 0
    g["fed_ns"][task], g["touched_ns"][0] = g["sent_ns"][task], now_ns
    rest_if_given(g)
    return True


@compiled
def give(g: Any, i: int, value: float) -> None:
    """The device has taken `value` of an output."""
    settle(g, i, value)
    g["register_low"][i] = g["register_high"][i] = g["last"][i] = value
    g["known"][i], g["given"][i] = 1, 1
    if g["state"][0] == SAFE_RAMP:
        g["share"][i] += g["period_s"][i] / g["ramp_s"][0]
