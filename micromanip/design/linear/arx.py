"""ARX(1), the least that is called a model: ``y[k] = a y[k-1] + b u[k-1-delay] + c`` for each output, least squares.

What is chosen with more care must not predict worse.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .modal import Array, Modes
from .model import LinearFit, delayed
from .subspace import Experiment

_STABLE = 1.0 - 1e-6


def fit_arx1(experiments: Sequence[Experiment], dt: float, delays: tuple[int, ...]) -> LinearFit:
    """The model for experiments ``(u (n, inputs), y (n, outputs))``, each with an offset of its own.

    It has no Kalman gain: what it leaves is white by assumption, and its state is the output.
    """
    offsets_u = np.concatenate([u for u, _ in experiments]).mean(axis=0)
    offsets_y = np.concatenate([y for _, y in experiments]).mean(axis=0)
    shifted = [delayed((u - offsets_u, y - offsets_y), delays) for u, y in experiments]
    outputs = len(offsets_y)
    poles, driven = np.empty(outputs, complex), np.empty((outputs, len(offsets_u)))
    covariance = np.zeros((outputs, outputs))
    left = []
    for o in range(outputs):
        rows = [np.column_stack([y[:-1, o], u[:-1]]) for u, y in shifted]
        table = np.concatenate([row - row.mean(axis=0) for row in rows])
        target = np.concatenate([y[1:, o] - y[1:, o].mean() for _, y in shifted])
        found = np.linalg.lstsq(table, target, rcond=None)[0]
        pole = float(np.clip(found[0], -_STABLE, _STABLE))
        poles[o], driven[o] = pole, found[1:]
        left.append(target - table @ found)
    covariance = np.atleast_2d(np.cov(np.array(left)))
    # a mode's real form has a real pole; two alike are kept apart by a rounding
    poles = poles - 1e-9 * np.arange(outputs)
    modes = Modes(poles, driven.astype(complex), np.eye(outputs).astype(complex), np.zeros((outputs, len(offsets_u))))
    gain = np.diag(poles).astype(complex)
    none: Array = np.zeros(0)
    return LinearFit(modes, dt, delays, offsets_u, offsets_y, gain, covariance, none, {})
