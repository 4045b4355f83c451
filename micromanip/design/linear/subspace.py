"""Past-output MOESP (Verhaegen 1994) for several inputs, outputs and experiments.

Future outputs, freed of what future inputs explain, are projected on past inputs and outputs; the column space
is the extended observability matrix. The block Hankel matrices of all experiments go through one QR factorisation
block by block, so that memory does not grow with the record.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, qr, svd

Array = NDArray[np.float64]
Experiment = tuple[Array, Array]

_BLOCK_COLUMNS = 4096


def block_hankel(signal: Array, rows: int, first: int, last: int) -> Array:
    """Columns `first` .. `last` of the block Hankel matrix of a signal (n, channels), `rows` block rows."""
    window = np.lib.stride_tricks.sliding_window_view(signal[first : last + rows - 1], rows, axis=0)
    return np.asarray(window.transpose(2, 1, 0).reshape(rows * signal.shape[1], -1))


def compressed(experiments: Sequence[Experiment], block_rows: int) -> Array:
    """Lower triangular factor of the stacked ``[U future; U past; Y past; Y future]`` of all experiments."""
    i = block_rows
    triangle: Array | None = None
    for u, y in experiments:
        columns = len(u) - 2 * i + 1
        inputs, outputs = u.shape[1], y.shape[1]
        for first in range(0, columns, _BLOCK_COLUMNS):
            last = min(columns, first + _BLOCK_COLUMNS)
            hu, hy = block_hankel(u, 2 * i, first, last), block_hankel(y, 2 * i, first, last)
            stacked = np.vstack([hu[i * inputs :], hu[: i * inputs], hy[: i * outputs], hy[i * outputs :]]).T
            if triangle is not None:
                stacked = np.vstack([triangle, stacked])
            triangle = np.asarray(qr(stacked, mode="r", check_finite=False)[0][: stacked.shape[1]])
    assert triangle is not None
    return triangle.T


def observability(experiments: Sequence[Experiment], block_rows: int) -> tuple[Array, Array]:
    """Left singular vectors (block_rows outputs, ..) of the projection, and its singular values."""
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    lower = compressed(experiments, block_rows)
    past = slice(block_rows * inputs, block_rows * (2 * inputs + outputs))
    future = slice(block_rows * (2 * inputs + outputs), None)
    left, values, _ = svd(lower[future, past], full_matrices=False)
    return np.asarray(left), np.asarray(values)


def dynamics(left: Array, order: int, outputs: int) -> tuple[Array, Array]:
    """``A`` (n, n) and ``C`` (outputs, n) from the first `order` columns, by shift invariance."""
    gamma = left[:, :order]
    return np.asarray(lstsq(gamma[:-outputs], gamma[outputs:])[0]), gamma[:outputs].copy()
