"""The outer loop's other regulator, for where the set-point can't follow the demand of the first.

A set-point that runs at its slew limit comes later than it is demanded, the more so the larger the error: no linear
margin tells of that, and fast gains then swing the stage from end to end. The same cost with much more weight on the
set-point demands so little that the slew limit hardly ever holds it. Model and filter are those of the first.
"""

from __future__ import annotations

import numpy as np

from .outer_gains import Matrix, OuterGains, OuterSettings, regulate
from .predictor import TrackerSettings, reference_transition

_WEIGHT = 30.0
"""So many times the weight of the set-point. 3 are too few for a burst of missed cycles, 10 do."""


def far_gains(
    outer: OuterSettings, gains: OuterGains, reference: TrackerSettings | None, period_s: float
) -> tuple[Matrix, Matrix]:
    """Feedback (n,) on the states and gains (r,) on the reference's, as in `gains`. Raises as ``outer_gains``."""
    S = reference_transition(reference.oscillations if reference else (), period_s)
    weight = _WEIGHT * outer.control_weight
    K, disturbance, following = regulate(gains.A, gains.B, gains.C, gains.controllable, weight, S)
    return np.concatenate([K, -disturbance]), following
