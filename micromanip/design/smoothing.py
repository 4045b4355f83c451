"""Offline state estimation over a recording: Kalman filter and Rauch-Tung-Striebel smoother, by filterpy.

The loop's own filter (`rt/laws/estimator.py`) knows only the past and has a stationary gain; here every sample has its
own gain, and the smoother also uses what came after it. Where the model is continuous, so is its process noise, and
both are discretised exactly (van Loan 1978).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, dlsim

if TYPE_CHECKING:
    import control

Array = NDArray[np.float64]

_UNKNOWN = 1e4
"""Variance of the state at the start, as a multiple of what inputs and noise make of it."""


@dataclass(frozen=True)
class Smoothed:
    """States (n, states) by the past alone (`filtered`) and by the whole record, with covariances (n, states, states).

    `output` (n, outputs) is what the smoothed state shows: the measurement without its noise.
    """

    filtered: Array
    filtered_covariance: Array
    smoothed: Array
    covariance: Array
    output: Array


def smooth(
    model: control.StateSpace,
    u: Array,
    y: Array,
    *,
    process_noise: Array,
    sensor_noise: Array,
    dt: float | None = None,
    initial_covariance: Array | None = None,
) -> Smoothed:
    """Estimate the states of `model` from its input `u` (n, inputs) and output `y` (n, outputs), NaN where missing.

    `sensor_noise` (outputs, outputs) is the covariance of a sample's noise, `process_noise` (states, states) that of
    the state's noise a sample; for a continuous model, which is sampled every `dt` seconds with its input held, the
    spectral density. The state at the start is taken as unknown, unless its covariance about 0 is given. Raises
    ValueError for a continuous model without `dt` and for covariances that are none.
    """
    from filterpy.kalman import KalmanFilter

    A, B, C, D, Q = _discrete(model, np.asarray(process_noise, dtype=float), dt)
    states, outputs = len(A), len(C)
    R = np.asarray(sensor_noise, dtype=float).reshape(outputs, outputs)
    np.linalg.cholesky(R)
    # filterpy's smoother knows no inputs: what they do is taken off before, and added again
    _, shown, driven = dlsim((A, B, C, D, 1.0), u)
    left_over = np.asarray(y, dtype=float).reshape(len(u), outputs) - shown
    kf = KalmanFilter(dim_x=states, dim_z=outputs)
    kf.F, kf.H, kf.Q, kf.R = A, C, Q, R
    if initial_covariance is None:
        size = driven.var(axis=0) + np.diag(Q)
        initial_covariance = _UNKNOWN * np.diag(np.where(size > 0, size, max(float(size.max()), 1.0)))
    kf.P = np.asarray(initial_covariance, dtype=float)
    samples = [row if np.isfinite(row).all() else None for row in left_over]
    filtered, covariance, _, _ = kf.batch_filter(samples, update_first=True)
    filtered = filtered.reshape(len(u), states)
    # states that are known exactly, like delays, have a singular covariance
    smoothed, narrower, _, _ = kf.rts_smoother(filtered, covariance, inv=partial(np.linalg.pinv, hermitian=True))
    return Smoothed(filtered + driven, covariance, smoothed + driven, narrower, smoothed @ C.T + shown)


def _discrete(model: control.StateSpace, noise: Array, dt: float | None) -> tuple[Array, Array, Array, Array, Array]:
    values, vectors = np.linalg.eigh(noise)
    if noise.shape != model.A.shape or not np.allclose(noise, noise.T) or values[0] < -1e-9 * max(values[-1], 0.0):
        raise ValueError(f"the process noise must be a covariance of {model.A.shape[0]} states")
    if model.dt:
        return model.A, model.B, model.C, model.D, noise
    if dt is None:
        raise ValueError("the model is continuous: say every how many seconds it was sampled (dt)")
    from filterpy.common import van_loan_discretization

    root = vectors * np.sqrt(np.maximum(values, 0.0))
    A, Q = van_loan_discretization(model.A, root, dt)
    _, B, C, D, _ = cont2discrete((model.A, model.B, model.C, model.D), dt)
    return A, B, C, D, Q
