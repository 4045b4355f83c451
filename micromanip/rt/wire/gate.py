"""What outputs may do whose commands can be lost on the way: nothing steps, whatever was lost, late or overtaken.

    FOLLOWING   the device is given the loop's outputs
    QUIET       the link was lost: nothing is sent, until the device's own watchdog has surely brought it to rest
    RESTING     it is given its safe values, until it answers and the loop itself asks for just these: nothing steps

Each frame that the device acts on is acknowledged, some time later. So it is known between which values lies what the
device has, and the next value is within a step of them all: however many were lost, nothing jumps.
``bus/safe_state.py`` does the same for buses.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.bus_image import DOWN, TAKEN
from micromanip.rt.jit import compiled
from micromanip.rt.record import record
from micromanip.rt.records import MAX_OUTPUTS

FOLLOWING, QUIET, RESTING = range(3)

ANSWERS = 3
"""So many answers, and the device counts as there again."""
RECENT = 64
"""So many of the last frames are remembered; an older one that is acknowledged says nothing new."""

_EQUAL = 1e-9

GATE = record(
    ("outputs", "i8"),
    ("state", "i8"),
    ("held", "i8"),
    ("silent_cycles", "i8"),
    ("patient_cycles", "i8"),
    ("watchdog_ns", "i8"),
    ("still_ns", "i8"),
    ("unanswered_in_a_row", "i8"),
    ("answers", "i8"),
    ("begun", "i8"),
    ("sent_ns", "i8"),
    ("sent_count", "i8"),
    ("acknowledged", "i8"),
    ("rest", "f8", (MAX_OUTPUTS,)),
    ("switch", "i8", (MAX_OUTPUTS,)),
    ("step", "f8", (MAX_OUTPUTS,)),
    ("given", "f8", (MAX_OUTPUTS,)),
    ("waits", "i8", (MAX_OUTPUTS,)),
    ("recent", "f8", (RECENT, MAX_OUTPUTS)),
    ("lowest", "f8", (MAX_OUTPUTS,)),
    ("highest", "f8", (MAX_OUTPUTS,)),
    ("unanswered", "i8"),
    ("refused_values", "i8"),
    ("held_back", "i8"),
    ("losses", "i8"),
)
"""``still_ns`` after the last frame all outputs are at rest by the device's watchdog. ``step`` is what two values that
the device gets one after the other may differ by; ``given`` is what it was sent last, ``waits`` (1) where that is not
yet what was asked for, ``recent`` what it was sent in each of the last frames, and what it has lies between ``lowest``
and ``highest``. ``sent_count`` frames were sent, of which the device has said that it has acted on the one before
``acknowledged``. Counted are cycles without a fresh answer, values that were not finite or out of range, which stayed,
those that had to wait for the device, which may still have had an older one, and how often the link was lost. While the
driver has set ``held`` the outputs do not begin to follow. After ``patient_cycles`` without an answer nothing more is
given: the device may have begun anew, at rest, and would be taken to its last value at once."""


@compiled
def acknowledge(g: Any, behind: int) -> int:
    """1 where the device has acted on a frame later than was known; it was sent `behind` frames before the last one.

    Then it has this one's values, or those of one that was sent after it.
    """
    last = g["sent_count"] - 1 - behind
    if behind < 0 or behind >= RECENT or last < g["acknowledged"]:
        return 0
    g["acknowledged"] = last + 1
    for i in range(g["outputs"]):
        g["lowest"][i] = g["highest"][i] = g["recent"][last % RECENT][i]
        for k in range(last + 1, g["sent_count"]):
            may_have(g, i, g["recent"][k % RECENT][i])
    return 1


@compiled
def may_have(g: Any, i: int, value: float) -> None:
    """Count `value` of output `i` among what the device may have."""
    g["lowest"][i], g["highest"][i] = min(g["lowest"][i], value), max(g["highest"][i], value)


@compiled
def has_rest(g: Any) -> None:
    """From now on the device has its safe values, and only what it is sent from now on counts as acknowledged."""
    g["state"], g["answers"], g["acknowledged"] = RESTING, 0, g["sent_count"]
    for i in range(g["outputs"]):
        g["lowest"][i] = g["highest"][i] = g["rest"][i]


@compiled
def lose(g: Any) -> None:
    """The link is lost: nothing more is sent, until the device is at rest."""
    if g["state"] == FOLLOWING:
        g["state"] = QUIET
        g["losses"] += 1
    g["answers"] = 0


@compiled
def near(g: Any, i: int, value: float) -> float:
    """What comes nearest to `value` and is within a step of all that the device may have; NaN stays NaN."""
    step = g["step"][i]
    g["waits"][i] = 0
    if g["highest"][i] - step <= value <= g["lowest"][i] + step or not math.isfinite(value):
        return value
    g["waits"][i] = 1
    g["held_back"] += 1
    return min(max(value, g["highest"][i] - step), g["lowest"][i] + step)


@compiled
def has_sent(g: Any) -> None:
    """A frame has left with what is ``given``."""
    for i in range(g["outputs"]):
        g["recent"][g["sent_count"] % RECENT][i] = g["given"][i]
        may_have(g, i, g["given"][i])
    g["sent_count"] += 1


@compiled
def put_back(g: Any, outputs: Any) -> None:
    """Put what was given in place of those of the loop's `outputs` that have to wait: it goes on from there."""
    for i in range(g["outputs"]):
        if g["waits"][i] != 0:
            outputs[i] = g["given"][i]


@compiled
def wait_for_device(g: Any) -> bool:
    """Whether the outputs have to wait, where they are, for an answer."""
    if g["unanswered_in_a_row"] <= g["patient_cycles"]:
        return False
    for i in range(g["outputs"]):
        g["waits"][i] = 1 - g["switch"][i]
    return True


@compiled
def asks_for_rest(g: Any, outputs: Any) -> bool:
    """Whether the loop wants every voltage at its safe value."""
    away = 0
    for i in range(g["outputs"]):
        if g["switch"][i] == 0 and not abs(outputs[i] - g["rest"][i]) <= _EQUAL:
            away += 1
    return away == 0


@compiled
def turn(g: Any, news: int, outputs: Any, deadline_ns: int) -> int:
    """One cycle with so many acknowledgements of something new: what ``exchange`` returns, 0, DOWN or TAKEN.

    0 is for the loop's outputs; else the safe values are due, and in QUIET nothing at all.
    """
    if news > 0:
        g["unanswered_in_a_row"] = 0
        g["answers"] += 1
        g["begun"] += 1 if g["answers"] == ANSWERS else 0
    else:
        g["unanswered_in_a_row"] += 1
        g["unanswered"] += 1
    silent = g["unanswered_in_a_row"] > g["silent_cycles"]
    away_ns = deadline_ns - g["sent_ns"]
    if silent or (g["state"] == FOLLOWING and away_ns > g["watchdog_ns"]):
        lose(g)
    if g["state"] == QUIET:
        if away_ns < g["still_ns"]:
            return DOWN
        has_rest(g)
    up = g["answers"] >= ANSWERS
    if g["state"] == RESTING and up and g["held"] == 0 and asks_for_rest(g, outputs):
        g["state"] = FOLLOWING
    if g["state"] == FOLLOWING:
        return 0
    return TAKEN if up else DOWN
