"""Past-output MOESP (Verhaegen 1994) for several inputs, outputs and experiments.

Future outputs, freed of what future inputs explain, are projected on past inputs and outputs; the column space
is the extended observability matrix. The block Hankel matrices of all experiments go through one QR factorisation
block by block, so that memory does not grow with the record. An offset of each experiment is an input that is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq, qr, solve_discrete_are, svd

from .modal import Array, Complex, Modes

Experiment = tuple[Array, Array]

_BLOCK_COLUMNS = 4096


@dataclass(frozen=True)
class Compressed:
    """Lower triangular factor of the stacked ``[offsets; U future; U past; Y past; Y future]``, and its parts."""

    lower: Array
    columns: int
    offsets: int
    inputs: int
    outputs: int
    block_rows: int

    @property
    def future_u(self) -> slice:
        return slice(self.offsets, self.offsets + self.block_rows * self.inputs)

    @property
    def past(self) -> slice:
        first = self.future_u.stop
        return slice(first, first + self.block_rows * (self.inputs + self.outputs))

    @property
    def future_y(self) -> slice:
        return slice(self.past.stop, None)


def block_hankel(signal: Array, rows: int, first: int, last: int) -> Array:
    """Columns `first` .. `last` of the block Hankel matrix of a signal (n, channels), `rows` block rows."""
    window = np.lib.stride_tricks.sliding_window_view(signal[first : last + rows - 1], rows, axis=0)
    return np.asarray(window.transpose(2, 1, 0).reshape(rows * signal.shape[1], -1))


def compress(experiments: Sequence[Experiment], block_rows: int) -> Compressed:
    """QR factorisation of the data ``(u (n, inputs), y (n, outputs))`` of all experiments."""
    i = block_rows
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    size = len(experiments) + 2 * i * (inputs + outputs)
    triangle, total = np.zeros((0, size)), 0
    for e, (u, y) in enumerate(experiments):
        columns = len(u) - 2 * i + 1
        total += columns
        for first in range(0, columns, _BLOCK_COLUMNS):
            last = min(columns, first + _BLOCK_COLUMNS)
            offsets = np.zeros((len(experiments), last - first))
            offsets[e] = 1.0
            hu, hy = block_hankel(u, 2 * i, first, last), block_hankel(y, 2 * i, first, last)
            parts = [offsets, hu[i * inputs :], hu[: i * inputs], hy[: i * outputs], hy[i * outputs :]]
            stacked = np.vstack([triangle, np.vstack(parts).T])
            triangle = np.asarray(qr(stacked, mode="r", check_finite=False)[0][:size])
    return Compressed(triangle.T, total, len(experiments), inputs, outputs, i)


def observability(data: Compressed) -> tuple[Array, Array]:
    """Left singular vectors (block_rows outputs, ..) of the projection, and its singular values."""
    left, values, _ = svd(data.lower[data.future_y, data.past], full_matrices=False)
    return np.asarray(left), np.asarray(values)


def dynamics(left: Array, order: int, outputs: int) -> tuple[Array, Array]:
    """``A`` (n, n) and ``C`` (outputs, n) from the first `order` columns, by shift invariance."""
    gamma = left[:, :order]
    return np.asarray(lstsq(gamma[:-outputs], gamma[outputs:])[0]), gamma[:outputs].copy()


# The state before and after each sample is estimated from past inputs and outputs, by the projections that the subspace
# method is made of; what the model leaves unexplained of the next state and of the output gives the covariances of
# process and sensor noise, and the Riccati equation the stationary gain (Van Overschee and De Moor 1996, chapter 3).

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
