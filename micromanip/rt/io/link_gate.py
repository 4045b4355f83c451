"""The gate (``gate.py``) of a wire that the loop itself serves, where silence is the one way to rest.

    FOLLOWING   the device is given the loop's outputs
    QUIET       the link was lost: nothing is sent, until the device's own watchdog has surely brought it to rest
    RESTING     it is given its safe values, until it answers and the loop itself asks for just these: nothing steps

The device acknowledges each frame that it acts on, some time later: so the bounds of the device's values are known,
however many frames were lost.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.bus_image import DOWN, FOLLOWING, RESTING, TAKEN, UNKNOWN
from micromanip.rt.jit import compiled
from micromanip.rt.record import arrays, record
from micromanip.rt.records import MAX_OUTPUTS

from .gate import HELD, VOLTAGE, asks_for_rest, settle, widen, within_step

QUIET = UNKNOWN

ANSWERS = 3
"""After so many answers the device counts as present again."""
RECENT = 64
"""Number of stored frames; the acknowledgement of an older one is ignored."""

LINK_GATE = record(
    *HELD,
    *arrays("i8", 0, "state", "held", "silent_cycles", "patient_cycles", "watchdog_ns", "still_ns"),
    *arrays("i8", 0, "unanswered_in_a_row", "answers", "begun", "sent_ns", "sent_count", "acknowledged"),
    *arrays("i8", MAX_OUTPUTS, "waits"),
    ("recent", "f8", (RECENT, MAX_OUTPUTS)),
    *arrays("i8", 0, "unanswered", "refused_values", "held_back", "losses"),
)
"""``still_ns`` after the last frame all outputs are at rest by the device's watchdog. An output ``waits`` (1) where
what was sent last is not yet what was asked for; ``recent`` was sent in each of the last frames. ``sent_count`` frames
were sent, of which the device has said that it has acted on the one before ``acknowledged``. Counted are cycles without
a fresh answer, values that were not finite or out of range, which stayed, those that had to wait for the device, which
may still have had an older one, and how often the link was lost. While the driver has set ``held`` the outputs do not
begin to follow. After ``patient_cycles`` without an answer nothing more is given: the device may have begun anew, at
rest, and would be taken to its last value at once."""


@compiled
def acknowledge(g: Any, behind: int) -> int:
    """The device has applied the frame sent `behind` frames before the last one; 1 if that is news.

    It then has the values of this frame, or of a later one.
    """
    last = g["sent_count"] - 1 - behind
    if behind < 0 or behind >= RECENT or last < g["acknowledged"]:
        return 0
    g["acknowledged"] = last + 1
    for i in range(g["outputs"][0]):
        settle(g, i, g["recent"][last % RECENT][i])
        for k in range(last + 1, g["sent_count"]):
            widen(g, i, g["recent"][k % RECENT][i])
    return 1


@compiled
def reset_to_safe(g: Any) -> None:
    """The device has its safe values; only frames sent from now on count as acknowledged."""
    g["state"], g["answers"], g["acknowledged"] = RESTING, 0, g["sent_count"]
    for i in range(g["outputs"][0]):
        settle(g, i, g["safe"][i])


@compiled
def on_link_lost(g: Any) -> None:
    """The link is lost: nothing more is sent, until the device is at rest."""
    if g["state"] == FOLLOWING:
        g["state"] = QUIET
        g["losses"] += 1
    g["answers"] = 0


@compiled
def near(g: Any, i: int, value: float) -> float:
    """What comes nearest to `value` and is within a step of all that the device may have; NaN stays NaN."""
    nearest = within_step(g, i, value) if math.isfinite(value) else value
    g["waits"][i] = math.isfinite(value) and nearest != value
    g["held_back"] += g["waits"][i]
    return nearest


@compiled
def has_sent(g: Any) -> None:
    """A frame has left with what was sent ``last``."""
    for i in range(g["outputs"][0]):
        g["recent"][g["sent_count"] % RECENT][i] = g["last"][i]
        widen(g, i, g["last"][i])
    g["sent_count"] += 1


@compiled
def put_back(g: Any, outputs: Any) -> None:
    """Replace the loop's `outputs` that have to wait by the given ones: the loop continues from there."""
    for i in range(g["outputs"][0]):
        if g["waits"][i] != 0:
            outputs[i] = g["last"][i]


@compiled
def wait_for_device(g: Any) -> bool:
    """Whether the outputs have to wait, where they are, for an answer."""
    if g["unanswered_in_a_row"] <= g["patient_cycles"]:
        return False
    for i in range(g["outputs"][0]):
        g["waits"][i] = g["kind"][i] == VOLTAGE
    return True


@compiled
def turn(g: Any, news: int, outputs: Any, deadline_ns: int) -> int:
    """One cycle with so many acknowledgements of something new: what ``exchange`` returns, 0, DOWN or TAKEN.

    With 0 the loop's outputs are due, else the safe values; in QUIET nothing is sent.
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
        on_link_lost(g)
    if g["state"] == QUIET:
        if away_ns < g["still_ns"]:
            return DOWN
        reset_to_safe(g)
    up = g["answers"] >= ANSWERS
    if g["state"] == RESTING and up and g["held"] == 0 and asks_for_rest(g, outputs):
        g["state"] = FOLLOWING
    if g["state"] == FOLLOWING:
        return 0
    return TAKEN if up else DOWN
