"""Filters at a resonance: a notch on the PID's error, and the actuator's resonances inverted.

Both are state-variable filters of trapezoidal integrators, warped so that their frequencies are exact for a step of any
length. x and y in um.

    y = x - share B x,   B(s) = k w0 s / (s^2 + k w0 s + w0^2)

Notch: removes a narrow band, so that the inner loop does not excite a resonance of the stage. w0 is the centre, k width
over centre: gain 1 at rest and far from the centre, ``1 - share`` in it. A step is as long as the PID's. Without input
its states lose energy at every step, however long: stable for every k > 0. It acts before the PID, so anti-windup acts
on the integrator alone, and so does a bumpless change. ``share`` 0 is no notch.

    y = H x,   H(s) = (w_z/w_p)^2 (s^2 + 2 d_p w_p s + w_p^2) / (s^2 + 2 d_z w_z s + w_z^2)

Resonance: the stage's mass on its flexure pulls at the gauge, near its own frequency. w_p, d_p: resonance and its
damping ratio, w_z, d_z: the antiresonance beside it. The actuator has the poles and zeros the other way round, so the
two together are 1 (model inversion, Devasia, IEEE Trans. Automatic Control 47 (2002) 1865). H is stable as long as
d_z > 0, and 1 at rest.
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
MAX_RESONANCES = 3

RESONANCES: tuple[Field, ...] = (
    ("resonances", "i8"),
    ("zero_tangent", "f8", (MAX_RESONANCES,)),
    ("zero_width", "f8", (MAX_RESONANCES,)),
    ("pole_band", "f8", (MAX_RESONANCES,)),
    ("pole_high", "f8", (MAX_RESONANCES,)),
)
"""Parameters: tan(w_z h/2), 2 d_z, and with q = tan(w_p h/2) / tan(w_z h/2) the shares 2 d_p/q and 1/q^2."""
RESONANCES_STATE: tuple[Field, ...] = (
    ("resonance_band_um", "f8", (MAX_RESONANCES,)),
    ("resonance_low_um", "f8", (MAX_RESONANCES,)),
)


@compiled
def integrate(g: float, k: float, band: float, low: float, x: float) -> tuple[float, float]:
    """Band and low pass of `x` from the states of the two integrators; the states behind are twice them less before."""
    band_out = (band + g * (x - low)) / (1.0 + g * (g + k))
    return band_out, low + g * band_out


@compiled
def notch_output(p: Record, s: Record, x_um: float, periods: int) -> float:
    """The error without the band, `periods` cycles after the step before."""
    if p["notch_share"] == 0.0:
        return x_um
    g = p["notch_tangent"] if periods == 1 else math.tan(min(periods * p["notch_angle"], _WIDEST))
    k = p["notch_width"]
    band, low = integrate(g, k, s["notch_band_um"], s["notch_low_um"], x_um)
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


@compiled.rare
def without_resonances(p: Record, s: Record, x_um: float) -> float:
    """Displacement (um) of the stack for which the gauge shows `x_um`; one cycle."""
    for i in range(p["resonances"]):
        g, k = p["zero_tangent"][i], p["zero_width"][i]
        band, low = integrate(g, k, s["resonance_band_um"][i], s["resonance_low_um"][i], x_um)
        s["resonance_band_um"][i] = 2.0 * band - s["resonance_band_um"][i]
        s["resonance_low_um"][i] = 2.0 * low - s["resonance_low_um"][i]
        x_um = low + p["pole_band"][i] * band + p["pole_high"][i] * (x_um - k * band - low)
    return x_um


@compiled.rare
def start_resonances(p: Record, s: Record, x_um: float) -> None:
    """At rest, as after `x_um` for long: what goes in comes out."""
    for i in range(p["resonances"]):
        s["resonance_band_um"][i] = 0.0
        s["resonance_low_um"][i] = x_um
