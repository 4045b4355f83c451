"""The course of every movement that the controller makes by itself: minimum jerk."""

from __future__ import annotations

from micromanip.rt.jit import compiled


def course(x: float) -> float:
    """From 0 to 1 for x in 0..1 (speed and acceleration vanish at both ends), for Python: nothing is compiled."""
    x = max(0.0, min(1.0, x))
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


minimum_jerk = compiled(course)
"""The same for the loop."""
