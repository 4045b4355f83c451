"""Kalman gains of the outer loop for samples that come after another time than the sensor's interval.

After a sample the stationary filter's covariance is P; m cycles later it is ``A^m P A^m' + Q_m``, Q_m what entered
meanwhile, and the gain of the sample that comes then follows from it. That is the exact filter where one sample comes
early or late among many in time. Among many out of time it is a filter with a little less gain than the exact one,
which needs no covariance in the loop; the stationary gain, applied to all, makes an estimate that runs away.
"""

from __future__ import annotations

import numpy as np

from .outer_gains import Matrix, OuterGains
from .remembered import remembered


def gap_gains(gains: OuterGains, gaps: int) -> Matrix:
    """Gains (gaps, n) for a sample 1, 2, .. `gaps` cycles after the one before; that of the interval is `gains`'."""
    of_the_filter = gains.A, gains.C, gains.noise, gains.covariance, gains.innovation_variance
    found = _gap_gains(*of_the_filter, gaps).copy()
    found[gains.sample_cycles - 1] = gains.observer
    return found


@remembered(16)
def _gap_gains(A: Matrix, C: Matrix, noise: Matrix, predicted: Matrix, variance: float, gaps: int) -> Matrix:
    sensor, found = variance - C @ predicted @ C, np.empty((gaps, len(A)))
    P = predicted - np.outer(predicted @ C, predicted @ C) / variance
    for row in range(gaps):
        P = A @ P @ A.T + noise
        found[row] = P @ C / (C @ P @ C + sensor)
    return found
