"""A learned correction: the repeating error of earlier identical parts, compensated at the reference during a part.

The correction c (um) is a column with one row per cycle from the beginning of the part; the path that it belongs to
follows in as many rows. Position, speed and acceleration of c are added to the reference's state, so that c goes
through the same law, and the same limits of set-point and voltage, as the reference itself. It never exceeds
``limit_um``. It begins with the part, ends after it, and fades out on a minimum-jerk course from the cycle in which the
reference is further than ``tolerance_um`` from the remembered path. It is not resumed in that part.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

from .move import minimum_jerk
from .predictor import position

IDLE, PLAYS, FINISHED, PATH_LEFT, BROKEN_OFF, WITHDRAWN, PART_ENDED, OTHER_TOOL = range(8)
"""Where an axis' correction stands, or why it ended: with its part; the reference left the path; the axis did not track
with all its sensors and its own gains; the memory was taken away; the part ended before its time; the tool is
not that of the memory."""

LEARNED_PARAMETERS = record(
    ("number", "i8"),
    ("rows", "i8"),
    ("column", "i8"),
    ("fade_cycles", "i8"),
    ("limit_um", "f8"),
    ("tolerance_um", "f8"),
    ("cycles_per_s", "f8"),
)
"""``rows`` 0 is none. ``number`` tells one memory from the next; 0 plays nothing, and ends what is played softly."""
LEARNED_STATE = record(
    ("number", "i8"),
    ("part", "i8"),
    ("why", "i8"),
    ("level", "f8"),
    ("apart_um", "f8"),
    ("played_um", "f8"),
)
"""``part`` is the cycle in which the part began that a correction began with last; ``apart_um`` how far the reference
was from the path when it was last looked at; ``played_um`` is what was last added to the reference, which counts
while ``level`` is above 0."""
_LATEST_FADES = 2
"""Later in its part nothing begins: a correction that still fades out is over by then."""


@compiled
def _played(p: Record, samples: Any, k: int, level: float) -> float:
    """Correction (um) of cycle `k` of the part, within its limit; the first and the last row go on."""
    value = samples[max(0, min(p["rows"] - 1, k)), p["column"]]
    return minimum_jerk(level) * max(-p["limit_um"], min(p["limit_um"], value))


@compiled
def _begin(p: Record, s: Record, order: Record, cycle: int) -> None:
    """Begin with a part that has not been played to."""
    part = order["part_begun"]
    if part < 0 or part == s["part"] or p["number"] == 0 or s["level"] > 0.0 or order["other_tool"] != 0:
        return
    if cycle - part <= _LATEST_FADES * p["fade_cycles"]:
        s["part"], s["number"], s["why"] = part, p["number"], PLAYS


@compiled
def _judge(p: Record, s: Record, order: Record, w: Any, samples: Any, k: int, allowed: bool) -> int:
    """Whether the correction continues in cycle `k` of its part, or why it ends."""
    if p["number"] != s["number"]:
        return WITHDRAWN
    if k >= p["rows"]:
        return FINISHED
    if order["other_tool"] != 0:
        return OTHER_TOOL
    if order["part_begun"] != s["part"]:
        return PART_ENDED
    if not allowed:
        return BROKEN_OFF
    s["apart_um"] = abs(position(w) - samples[p["rows"] + k, p["column"]])
    return PLAYS if s["apart_um"] <= p["tolerance_um"] else PATH_LEFT


@compiled
def add_learned(p: Record, s: Record, order: Record, w: Any, samples: Any, cycle: int, allowed: bool) -> None:
    """Add what is played in this cycle to the reference `w`: position, velocity and acceleration.

    `order` says which part runs and whether the tool is another one: ``axis_order.py``.
    """
    if not 0 < 2 * p["rows"] <= len(samples):
        return
    if s["why"] != PLAYS:
        _begin(p, s, order, cycle)
    k = cycle - s["part"]
    if s["why"] == PLAYS:
        s["why"] = _judge(p, s, order, w, samples, k, allowed)
    step, level = 1.0 / p["fade_cycles"], s["level"]
    s["level"] = min(1.0, level + step) if s["why"] == PLAYS else max(0.0, level - step)
    if s["level"] == 0.0:
        return
    slope, rate = s["level"] - level, p["cycles_per_s"]
    before, after = _played(p, samples, k - 1, level), _played(p, samples, k + 1, s["level"] + slope)
    now = _played(p, samples, k, s["level"])
    s["played_um"] = now
    w[0] += now
    w[1] += 0.5 * rate * (after - before)
    w[2] += rate * rate * (after - 2.0 * now + before)


@compiled
def forget_played(s: Record) -> None:
    """The axis is at rest: clear the correction."""
    s["level"] = 0.0
    if s["why"] == PLAYS:
        s["why"] = BROKEN_OFF
