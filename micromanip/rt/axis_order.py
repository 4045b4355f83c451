"""The cell's order for an axis in a cycle: the only input of the cell's state, checks, parts and devices to the laws.

The cell writes the order and no state of a law; the laws read it. A candidate tuning gets the same orders.
"""

from __future__ import annotations

from typing import Any

from .jit import compiled
from .record import Record, record

AXIS_ORDER = record(
    ("phase", "i8"),
    ("missed", "i8"),
    ("reasons", "i8"),
    ("behind", "i8"),
    ("level", "f8"),
    ("held_share", "f8"),
    ("held_since", "i8"),
    ("authority", "f8"),
    ("offset", "f8"),
    ("start_V", "f8"),
    ("time_s", "f8"),
    ("followed", "i8"),
    ("may_move", "i8"),
    ("part_begun", "i8"),
    ("other_tool", "i8"),
)
"""``phase``: of ``states.py``; ``missed``: cycles before this one; ``reasons``: what the watch has found, bits of
``supervisor.py``; ``behind``: for how many cycles the device has had less (or, negative, more) than was asked for.

``level``: how far (0..1) a ramp is, or from where the axis is held to its reference; ``held_share``: what is left of
the place where it is held; ``held_since``: the cycle in which it was to be held anew; ``authority``: the share of the
reference that it may follow; ``offset``: um, or V while probing, on top in a check or a sweep; ``start_V``: where a
ramp, a lift or a check began.

``time_s``: of the own source, below 0 while it waits; ``followed``: a reference that is lost may not come back
elsewhere; ``may_move``: it is held, and nothing is wrong; ``part_begun``: the cycle in which the part that runs began,
-1 where none does; ``other_tool``: not 0 where the learned correction is of another one."""


@compiled
def hold_here(s: Record, i: int) -> None:
    """From this cycle on axis `i` is held where it is."""
    s["order"][i]["held_since"] = s["cycle"]


@compiled
def see_behind(p: Record, s: Record, outputs: Any) -> None:
    """After an exchange: count the cycles in which `outputs`, what the devices have, is not what was asked for."""
    for i in range(p["axes"]):
        order, lacking_V = s["order"][i], s["axis"][i]["voltage_V"] - outputs[p["axis"][i]["voltage"]]
        direction, before = int(lacking_V > 0.0) - int(lacking_V < 0.0), order["behind"]
        order["behind"] = before + direction if before * direction > 0 else direction
