"""Decoupling: what an axis adds to its set-point because its stage also moves with the references of the others.

A stage sees a share c_ij of axis j's motion. Its own sensor sees it too, so the outer loop takes it away, but only as
fast as it takes any disturbance away. What the others are going to do is known, though: their references r_j. So

    u_i = .. - sum_j c_ij / g_i (r_j + lead_i r_j')

with the steady gain g_i of the stage, and the lead by which it answers later at low frequencies. It is feedforward: no
loop is closed by it, and no margin changes. The estimator is not told of it, since what it moves and what it takes away
are the same. Shares that change, or are switched off, are led to their new values slowly (``EASED``).
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import MAX_AXES, Record, record

from .joints import MAX_MODES
from .motion import position
from .saturation import slewed

EASED = 0.01
"""Change of a share, um of set-point per um, in the time in which the authority comes."""
DECOUPLING_PARAMETERS = record(("active", "i8"), ("lead_s", "f8"), ("share", "f8", (MAX_AXES,)))
"""``share``: c_ij / g_i by axis; ``active`` 0: there is none."""
DECOUPLING_STATE = record(
    ("active", "i8"), ("added_um", "f8"), ("share", "f8", (MAX_AXES,)), ("part_um", "f8", (MAX_AXES,))
)
"""The shares as they are now, what each axis' reference adds to the set-point, and their sum."""


@compiled
def add_part(p: Record, s: Record, j: int, step: float, w: Any, follows: bool) -> None:
    """Add what the reference `w` of axis `j` asks for, as last followed; its share is eased by `step` at most."""
    s["share"][j] = slewed(s["share"][j], p["share"][j], step)
    if s["share"][j] != 0.0:
        s["active"] = 1
    if follows:
        speed = w[1]
        for k in range(MAX_MODES):
            speed += w[4 + 2 * k]
        s["part_um"][j] = -s["share"][j] * (position(w) + p["lead_s"] * speed)
    s["added_um"] += s["part_um"][j]


@compiled
def forget(s: Record) -> None:
    """Nothing is added any more; it begins anew from nothing."""
    s["active"], s["added_um"] = 0, 0.0
    for j in range(MAX_AXES):
        s["share"][j] = s["part_um"][j] = 0.0
