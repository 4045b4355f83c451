"""Past-output MOESP (Verhaegen 1994) for several inputs, outputs and experiments.

Future outputs, freed of what future inputs explain, are projected on past inputs and outputs; the column space
is the extended observability matrix. The block Hankel matrices of all experiments go through one QR factorisation
block by block, so that memory does not grow with the record. An offset of each experiment is an input that is 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import lstsq, qr, svd

from .modal import Array

Experiment = tuple[Array, Array]

_BLOCK_COLUMNS = 4096


def block_hankel(signal: Array, rows: int, first: int, last: int) -> Array:
    """Columns `first` .. `last` of the block Hankel matrix of a signal (n, channels), `rows` block rows."""
    window = np.lib.stride_tricks.sliding_window_view(signal[first : last + rows - 1], rows, axis=0)
    return np.asarray(window.transpose(2, 1, 0).reshape(rows * signal.shape[1], -1))


def observability(experiments: Sequence[Experiment], block_rows: int) -> tuple[Array, Array]:
    """Left singular vectors (block_rows outputs, ..) of the projection, and its singular values.

    Of the data ``(u (n, inputs), y (n, outputs))`` of all experiments.
    """
    i = block_rows
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    size = len(experiments) + 2 * i * (inputs + outputs)
    triangle = np.zeros((0, size))
    for e, (u, y) in enumerate(experiments):
        columns = len(u) - 2 * i + 1
        for first in range(0, columns, _BLOCK_COLUMNS):
            last = min(columns, first + _BLOCK_COLUMNS)
            offsets = np.zeros((len(experiments), last - first))
            offsets[e] = 1.0
            hu, hy = block_hankel(u, 2 * i, first, last), block_hankel(y, 2 * i, first, last)
            parts = [offsets, hu[i * inputs :], hu[: i * inputs], hy[: i * outputs], hy[i * outputs :]]
            stacked = np.vstack([triangle, np.vstack(parts).T])
            triangle = np.asarray(qr(stacked, mode="r", check_finite=False)[0][:size])
    past = len(experiments) + i * inputs
    future = past + i * (inputs + outputs)
    left, values, _ = svd(triangle.T[future:, past:future], full_matrices=False)
    return np.asarray(left), np.asarray(values)


def dynamics(left: Array, order: int, outputs: int) -> tuple[Array, Array]:
    """``A`` (n, n) and ``C`` (outputs, n) from the first `order` columns, by shift invariance."""
    gamma = left[:, :order]
    return np.asarray(lstsq(gamma[:-outputs], gamma[outputs:])[0]), gamma[:outputs].copy()
