"""Kalman gain of the innovation form ``x+ = A x + B u + K e``, ``y = C x + D u + e`` from the data.

The state before and after each sample is estimated from past inputs and outputs, by the projections that the subspace
method is made of; what the model leaves unexplained of the next state and of the output gives the covariances of
process and sensor noise, and the Riccati equation the stationary gain (Van Overschee and De Moor 1996, chapter 3).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lstsq, qr, solve_discrete_are

from .modal import Array, Complex, Modes
from .subspace import Compressed

_TRACE = 1e-12
"""Noise that is always there, as a share of the outputs' variance: the Riccati equation stays solvable without any."""
_RANK = 1e-9


def kalman_gain(modes: Modes, data: Compressed) -> tuple[Complex, Array]:
    """Gain by modes (k, outputs) and covariance (outputs, outputs) of the innovations."""
    A, B, C, D = modes.state_space()
    i, m, outputs, e = data.block_rows, data.inputs, data.outputs, data.offsets
    gamma = [C]
    for _ in range(i - 1):
        gamma.append(gamma[-1] @ A)
    observability = np.vstack(gamma)
    lower = data.lower
    # rows of the next sample's data: the first future samples have become past
    fu, past, fy = data.future_u, data.past, data.future_y
    now_u, now_y = slice(fu.start, fu.start + m), slice(fy.start, fy.start + outputs)
    before = _states(lower[:e], lower[fu], lower[past], lower[fy], observability)
    longer = np.vstack([lower[past], lower[now_u], lower[now_y]])
    later_u, later_y = lower[now_u.stop : fu.stop], lower[now_y.stop :]
    after = _states(lower[:e], later_u, longer, later_y, observability[:-outputs])
    w = (after - A @ before - B @ lower[now_u])[:, e:]
    v = (lower[now_y] - C @ before - D @ lower[now_u])[:, e:]
    stacked = np.vstack([w, v])
    covariance = stacked @ stacked.T / data.columns
    n = len(A)
    Q, S, R = covariance[:n, :n], covariance[:n, n:], covariance[n:, n:]
    Q, R = Q + _TRACE * np.eye(n), R + _TRACE * np.eye(outputs)
    P = solve_discrete_are(A.T, C.T, Q, R, s=S)
    innovations = C @ P @ C.T + R
    gain: Array = np.asarray(np.linalg.solve(innovations, (A @ P @ C.T + S).T).T, dtype=np.float64)
    return modes.complex_rows(gain), np.asarray(innovations)


def _states(offsets: Array, future_u: Array, past: Array, future_y: Array, gamma: Array) -> Array:
    """States estimated from the past, in the coordinates of the factorisation."""
    order = np.vstack([offsets, future_u, past, future_y])
    triangle = np.asarray(qr(order.T, mode="r", check_finite=False)[0]).T
    first = len(offsets) + len(future_u)
    known = slice(first, first + len(past))
    by_past = lstsq(triangle[known, known].T, triangle[known.stop :, known].T, cond=_RANK)[0].T
    return np.asarray(lstsq(gamma, by_past @ past)[0])
