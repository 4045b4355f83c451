"""A second-order section: the filters by which the inner loop's swings are told from what it is asked for."""

from __future__ import annotations

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
