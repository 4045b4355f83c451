"""Gains of the outer loop away from the nominal case: for samples out of time, and for a set-point that is too slow.

After a sample the stationary filter's covariance is P; m cycles later it is ``A^m P A^m' + Q_m``, with the process
noise Q_m of these cycles, and the gain of the next sample follows from it. This is the exact filter if one sample is
early or late among many in time. If many are out of time, the gain is a little less than the exact one, which would
need a covariance in the loop. With the stationary gain for all samples the estimate diverges.

A slew limit delays the set-point more the larger the error is. No linear margin shows that, and fast gains then swing
the stage from end to end. The calm gains minimise the same cost with much more weight on the set-point, so that it
hardly ever reaches the slew limit. Model and filter are the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .cached_arrays import cached_arrays
from .outer_gains import Matrix, OuterGains, regulate
from .predictor import reference_transition

if TYPE_CHECKING:
    from micromanip.settings.schema.axis import Outer
    from micromanip.settings.schema.reference import AxisTracker

_CALM_WEIGHT = 30.0
"""So many times the weight of the set-point. 3 are too few for a burst of missed cycles, 10 do."""


def intermittent_gains(gains: OuterGains, gaps: int) -> Matrix:
    """Gains (gaps, n) for a sample 1, 2, .. `gaps` cycles after the one before; that of the interval is `gains`'."""
    of_the_filter = gains.A, gains.C, gains.noise, gains.covariance, gains.innovation_variance
    found = _intermittent_gains(*of_the_filter, gaps).copy()
    found[gains.sample_cycles - 1] = gains.observer
    return found


@cached_arrays(16)
def _intermittent_gains(A: Matrix, C: Matrix, noise: Matrix, predicted: Matrix, variance: float, gaps: int) -> Matrix:
    sensor, found = variance - C @ predicted @ C, np.empty((gaps, len(A)))
    P = predicted - np.outer(predicted @ C, predicted @ C) / variance
    for row in range(gaps):
        P = A @ P @ A.T + noise
        found[row] = P @ C / (C @ P @ C + sensor)
    return found


def calm_gains(
    outer: Outer, gains: OuterGains, reference: AxisTracker | None, period_s: float
) -> tuple[Matrix, Matrix]:
    """Feedback (n,) on the states and gains (r,) on the reference's, as in `gains`. Raises as ``outer_gains``."""
    S = reference_transition(reference.oscillations if reference else (), period_s)
    weight = _CALM_WEIGHT * outer.control_weight
    K, disturbance, following = regulate(gains.A, gains.B, gains.C, gains.controllable, weight, S)
    return np.concatenate([K, -disturbance]), following
