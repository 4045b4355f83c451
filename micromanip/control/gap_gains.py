"""Kalman gains of the outer loop for samples that come after another time than the sensor's interval.

After a sample the stationary filter's covariance is P; m cycles later it is ``A^m P A^m' + Q_m``, Q_m what entered
meanwhile, and the gain of the sample that comes then follows from it. That is the exact filter where one sample comes
early or late among many in time. Among many out of time it is a filter with a little less gain than the exact one,
which needs no covariance in the loop; the stationary gain, applied to all, makes an estimate that runs away.
"""

from __future__ import annotations

import numpy as np

from .outer_gains import Matrix, OuterGains, OuterSettings, predicted_covariance, process_noise


def gap_gains(outer: OuterSettings, gains: OuterGains, gaps: int) -> Matrix:
    """Gains (gaps, n) for a sample 1, 2, .. `gaps` cycles after the one before; that of the interval is `gains`'."""
    A, C, own = gains.A, gains.C, gains.sample_cycles
    P, variance = predicted_covariance(outer, A, C, gains.controllable)
    noise, found = process_noise(outer, A, gains.controllable), np.empty((gaps, len(A)))
    P = P - np.outer(P @ C, P @ C) / variance
    for row in range(gaps):
        P = A @ P @ A.T + noise
        found[row] = P @ C / (C @ P @ C + outer.sensor_noise_um**2)
    found[own - 1] = gains.observer
    return found
