"""An oscillator that turns at another frequency than was said: found from the phase of its own corrections.

Its states ``o = (o1, o2)`` are ``A (sin th, cos th)``; th grows by the configured frequency and what was found beyond
it. A sample's correction ``d`` of the states moves th by

    lead = (o2 d1 - o1 d2) / |o|^2

and where the frequency is another one, every correction moves it the same way: what was found takes up a share of that,
within a range and no faster than its slew. With b the share of the oscillator's error that a sample removes and g the
share of the lead that is taken up, the linearised loop is ``z^2 - (2 - b) z + 1 - b + b g``: a phase-locked loop whose
filter is the Kalman gain (Gardner, Phaselock Techniques, chapter 2) and has a damping of ``sqrt(b / g) / 2``. Far from
the frequency the oscillator is dragged around at the difference, so that the lead says it without being locked.
"""

from __future__ import annotations

from micromanip.rt.jit import compiled


@compiled
def locked(
    found: float, o1: float, o2: float, d1: float, d2: float, share: float, slew: float, low: float, high: float
) -> float:
    """What is `found` after a correction (d1, d2) of the states (o1, o2), which are not both 0."""
    step = share * (o2 * d1 - o1 * d2) / (o1 * o1 + o2 * o2)
    return max(low, min(high, found + max(-slew, min(slew, step))))
