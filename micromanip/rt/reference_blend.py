"""One reference for the loops: a level between the place where the axis is held and what it tracks.

    w = held + level (tracked - held)

In a lift the axis is held where it began, in a hold where it was then; ``held_share`` of the cell's order leads that
place to rest. Of the tracked reference the axis may follow a share, its authority, which changes slowly.
"""

from __future__ import annotations

from micromanip.rt.laws.estimator import output
from micromanip.rt.laws.reference import REFERENCE_STATES, SIGNAL

from .jit import compiled
from .record import Record, record
from .states import CLOSED, STAGE

BLEND_STATE = record(("held_since", "i8"), ("held_um", "f8"), ("authority", "f8"))
"""By what order, and where, the axis is held; the authority as it is now."""


@compiled
def start_blend(p: Record, s: Record, held_um: float) -> None:
    """At rest at `held_um`; the first cycle with closed loops holds it anew."""
    s["held_since"], s["held_um"], s["authority"] = -1, held_um, p["authority"]


@compiled
def blended(held: float, tracked: float, level: float) -> float:
    """`level` (0..1) of the way from `held` to `tracked`."""
    return held + level * (tracked - held)


@compiled
def hold_anew(p: Record, s: Record, order: Record) -> bool:
    """Whether the axis is held, or tracks, from this cycle on: then it begins where it is."""
    b = s["blend"]
    if b["held_since"] == order["held_since"]:
        return False
    b["held_since"] = order["held_since"]
    b["held_um"] = output(p["outer"], s["estimator"]["x"]) if p["mode"] == STAGE else s["setpoint_um"]
    return True


@compiled
def blended_position(p: Record, s: Record, order: Record) -> float:
    """Set-point (um, or V in the open-loop mode) of an axis without an outer loop, or before that is closed."""
    b, reference = s["blend"], s["reference"]
    follows = p["reference"]["kind"] == SIGNAL
    if order["phase"] != CLOSED:
        target_um = p["centre_um"] if follows or p["mode"] == STAGE else reference["ahead_um"]
        return blended(b["held_um"], target_um, order["level"]) + order["offset"]
    hold_anew(p, s, order)
    b["held_um"] += s["move"]["speed_um"]
    target = p["centre_um"] + b["authority"] * reference["w"][0] if follows else reference["ahead_um"]
    rest = p["centre_um"] if follows else b["held_um"]
    return blended(blended(rest, b["held_um"], order["held_share"]), target, order["level"])


@compiled
def blend_state(p: Record, s: Record, order: Record) -> None:
    """Blend the reference's state w for the outer loop, with the move of where the axis is held."""
    b, w, move, level = s["blend"], s["reference"]["w"], s["move"], order["level"]
    b["held_um"] += move["speed_um"]
    w[0] = blended(order["held_share"] * b["held_um"], b["authority"] * w[0], level)
    for i in range(1, REFERENCE_STATES):
        w[i] *= level * b["authority"]
    w[1] += move["speed_um"] * p["cycles_per_ns"] * 1e9
    w[2] += move["acceleration_um"] * (p["cycles_per_ns"] * 1e9) ** 2
