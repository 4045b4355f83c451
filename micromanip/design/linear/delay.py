"""How many samples an input takes to show: leading zeros of the input's part in a long autoregression.

``y[k] = sum a_i y[k-i] + sum b_i u[k-i] + e[k]``: whatever the dynamics and however long they ring, the first `b_i`
that differs from zero sits at the input's delay. "Differs" is judged by its standard error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr, solve_triangular

from .subspace import Experiment, block_hankel

_SIGNIFICANT = 6.0
"""Standard errors; some hundred coefficients are looked at."""
_VISIBLE = 0.01
"""Share of the input's largest coefficient: what is smaller is the rounding of a record without noise."""
_TRACE = 1e-7
"""Ridge, relative: without noise the past outputs are linearly dependent."""


def first_answers(experiments: Sequence[Experiment], lags: int) -> list[int]:
    """The lag (samples, 0 .. `lags`) at which each input first shows in any output; 0 where it never does.

    Signals of the experiments ``(u (n, inputs), y (n, outputs))`` should be of like size.
    """
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    size = 1 + inputs * (lags + 1) + outputs * lags
    triangle, rows = np.zeros((0, size + outputs)), 0
    for u, y in experiments:
        columns = len(u) - lags
        past_u = block_hankel(u, lags + 1, 0, columns)[::-1]
        whole_y = block_hankel(y, lags + 1, 0, columns)[::-1]
        stacked = np.vstack([np.ones((1, columns)), past_u, whole_y[outputs:], whole_y[:outputs][::-1]]).T
        triangle = np.asarray(qr(np.vstack([triangle, stacked]), mode="r", check_finite=False)[0][: size + outputs])
        rows += columns
    ridge = _TRACE * np.sqrt(rows) * np.eye(size, size + outputs)
    triangle = np.asarray(qr(np.vstack([triangle, ridge]), mode="r", check_finite=False)[0][: size + outputs])
    R, cross = triangle[:size, :size], triangle[:size, size:]
    inverse = np.asarray(solve_triangular(R, np.eye(size)))
    error = np.sqrt(np.sum(triangle[size:, size:] ** 2, axis=0) / max(rows - size, 1))
    # block_hankel[::-1] runs through the channels backwards too
    by_u = slice(1, 1 + inputs * (lags + 1))
    b = (inverse @ cross)[by_u].reshape(lags + 1, inputs, outputs)[:, ::-1]
    spread = np.sqrt(np.sum(inverse**2, axis=1))[by_u].reshape(lags + 1, inputs)[:, ::-1, None] * error
    shows = (np.abs(b) > _SIGNIFICANT * spread) & (np.abs(b) > _VISIBLE * np.abs(b).max(axis=0))
    return [int(np.argmax(seen)) for seen in shows.any(axis=2).T]
