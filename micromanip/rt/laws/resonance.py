"""Resonances of the actuator, inverted: the stage's mass on its flexure pulls at the gauge, near its own frequency.

    y = H x,   H(s) = (w_z/w_p)^2 (s^2 + 2 d_p w_p s + w_p^2) / (s^2 + 2 d_z w_z s + w_z^2)

x and y in um; w_p, d_p: resonance and its damping ratio, w_z, d_z: the antiresonance beside it. The actuator has the
poles and zeros the other way round, so the two together are 1 (model inversion, Devasia, IEEE Trans. Automatic Control
47 (2002) 1865). H is stable as long as d_z > 0, and 1 at rest. Each is a state-variable filter of trapezoidal
integrators, both frequencies warped so that they are exact; its states are those of ``notch.py``.
"""

from __future__ import annotations

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record

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


@compiled.rare
def without_resonances(p: Record, s: Record, x_um: float) -> float:
    """Displacement (um) to ask of the stack, so that the gauge shows `x_um`; one cycle."""
    for i in range(p["resonances"]):
        g, k = p["zero_tangent"][i], p["zero_width"][i]
        band = (s["resonance_band_um"][i] + g * (x_um - s["resonance_low_um"][i])) / (1.0 + g * (g + k))
        low = s["resonance_low_um"][i] + g * band
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
