"""Swings of the inner loop: energy of its error in the band where it would swing.

Without the tooth's frequency, whose cancelling asks much of the loop, and only what is more than the set-point's own
there: an error in following is no swing. A loop that swings has the larger error, also where the outer loop answers it.
The filters are second-order sections. They take the gauge's samples, not the cycles between: a held one would look like
a swing.
"""

from __future__ import annotations

import math

from .jit import compiled
from .record import Record, record

SECTION = record(("b", "f8", (3,)), ("a", "f8", (2,)))
"""y[n] = b0 x[n] + b1 x[n-1] + b2 x[n-2] - a0 y[n-1] - a1 y[n-2]."""
SECTION_STATE = record(("x1", "f8"), ("x2", "f8"), ("y1", "f8"), ("y2", "f8"))
"""The last two inputs and outputs."""


@compiled
def start_section(p: Record, s: Record, x: float) -> float:
    """Start as after a long rest at `x`; returns the output there."""
    b, a = p["b"], p["a"]
    s["x1"] = s["x2"] = x
    s["y1"] = s["y2"] = y = x * (b[0] + b[1] + b[2]) / (1.0 + a[0] + a[1])
    return y


@compiled
def section_output(p: Record, s: Record, x: float) -> float:
    """One step: the output for the input `x`."""
    b, a = p["b"], p["a"]
    y = b[0] * x + b[1] * s["x1"] + b[2] * s["x2"] - a[0] * s["y1"] - a[1] * s["y2"]
    s["x2"], s["x1"] = s["x1"], x
    s["y2"], s["y1"] = s["y1"], y
    return y


@compiled
def swing_um(w: Record) -> float:
    """The rms (um) of what swings in the band."""
    return math.sqrt(max(0.0, w["band_energy"]))


@compiled
def watch_oscillation(limits: Record, a: Record, w: Record, active: bool) -> None:
    """Carry ``band_energy`` (um^2) on by a fresh sample; while not `active` it is 0, and the filters are at rest."""
    band_pass, notch = limits["band_pass"], limits["tooth_notch"]
    if not active:
        start_section(notch, w["error_notch"], start_section(band_pass, w["error_band"], 0.0))
        start_section(notch, w["asked_notch"], start_section(band_pass, w["asked_band"], a["setpoint_um"]))
        w["band_energy"] = 0.0
    elif a["error_fresh"]:
        error_um = section_output(
            notch, w["error_notch"], section_output(band_pass, w["error_band"], a["strain_error_um"])
        )
        asked_um = section_output(notch, w["asked_notch"], section_output(band_pass, w["asked_band"], a["setpoint_um"]))
        w["band_energy"] += limits["band_step"] * (error_um * error_um - asked_um * asked_um - w["band_energy"])
