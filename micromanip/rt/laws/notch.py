"""Notch on the PID's error: a narrow band is taken out, so that the inner loop does not drive a resonance of the stage.

    y = x - share B x,   B(s) = k w0 s / (s^2 + k w0 s + w0^2)

x and y in um, w0 the centre, k width over centre: gain 1 at rest and far from the centre, ``1 - share`` in it. B is a
state-variable filter of trapezoidal integrators, warped so that the centre is exact for a step of any length; a step
is as long as the PID's. Without input its states lose energy at every step, however long: stable for every k > 0.

It stands before the PID, not behind it: so what the limiter takes away unwinds the integrator itself, and a
bumpless change is the integrator's alone. ``share`` 0 is no notch.
"""

from __future__ import annotations

import math

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record

NOTCH: tuple[Field, ...] = (
    ("notch_share", "f8"),
    ("notch_width", "f8"),
    ("notch_angle", "f8"),
    ("notch_tangent", "f8"),
)
"""Parameters: share, k, half of the angle (rad) that the centre turns by in a cycle, and its tangent."""
NOTCH_STATE: tuple[Field, ...] = (("notch_band_um", "f8"), ("notch_low_um", "f8"), ("notch_um", "f8"))
"""The two integrators, and what was taken from the last error."""

_WIDEST = 0.45 * math.pi
"""Half angle of the longest step: samples further apart don't show the centre, and mean an outage."""


@compiled
def notch_output(p: Record, s: Record, x_um: float, periods: int) -> float:
    """The error without the band, `periods` cycles after the step before."""
    if p["notch_share"] == 0.0:
        return x_um
    g = p["notch_tangent"] if periods == 1 else math.tan(min(periods * p["notch_angle"], _WIDEST))
    k = p["notch_width"]
    band = (s["notch_band_um"] + g * (x_um - s["notch_low_um"])) / (1.0 + g * (g + k))
    low = s["notch_low_um"] + g * band
    s["notch_band_um"] = 2.0 * band - s["notch_band_um"]
    s["notch_low_um"] = 2.0 * low - s["notch_low_um"]
    s["notch_um"] = p["notch_share"] * k * band
    return x_um - s["notch_um"]


@compiled
def start_notch(p: Record, s: Record, x_um: float) -> None:
    """At rest, as after an error of `x_um` for long: what goes in comes out."""
    s["notch_band_um"] = s["notch_um"] = 0.0
    s["notch_low_um"] = x_um if p["notch_share"] != 0.0 else 0.0


@compiled
def is_same_notch(old: Record, new: Record) -> bool:
    """Whether the states of the one are those of the other."""
    return (
        old["notch_share"] == new["notch_share"]
        and old["notch_width"] == new["notch_width"]
        and old["notch_angle"] == new["notch_angle"]
    )
