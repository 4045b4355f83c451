"""The course of every movement that the controller makes by itself: minimum jerk."""

from __future__ import annotations

from micromanip.rt.jit import compiled


@compiled
def minimum_jerk(x: float) -> float:
    """From 0 to 1 for x in 0..1; speed and acceleration vanish at both ends."""
    x = max(0.0, min(1.0, x))
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
