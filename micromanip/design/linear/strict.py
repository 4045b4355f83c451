"""How a model predicts what it was not shown: state and offset by the first tenth of a part, judged on the rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .modal import Array
from .model import LinearFit, as_columns, delayed
from .regression import start
from .subspace import Experiment

_SHOWN = 0.1
_LEAST_SHOWN = 3
"""Samples a state that are shown at least: fewer would fix the state by the noise."""


def strict_errors(model: LinearFit, experiments: Sequence[Experiment]) -> Array:
    """Rms error (outputs,) of the free run, percent of the outputs' rms, averaged over experiments ``(u, y)``.

    Beyond their first tenth, to which state and offset are fitted; parts too short for that are left out. Infinite
    where no part is long enough, or the run leaves all bounds.
    """
    squares = [found for u, y in experiments if (found := _squares(model, as_columns(u), as_columns(y))) is not None]
    if not squares:
        return np.full(len(model.offsets_y), np.inf)
    mean = np.mean(squares, axis=0)
    return np.where(np.isfinite(mean), 100.0 * np.sqrt(mean), np.inf)


def _squares(model: LinearFit, u: Array, y: Array) -> Array | None:
    """Mean square error over mean square, (outputs,)."""
    driven, measured = delayed((u - model.offsets_u, y), model.delays)
    shown = max(round(_SHOWN * len(measured)), _LEAST_SHOWN * (model.order + 1))
    rest = measured[shown:]
    if len(rest) < shown or not np.ptp(rest, axis=0).all():
        return None
    run = start(model.modes, driven[:shown], measured[:shown]).run(model.modes, driven)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.mean((rest - run[shown:]) ** 2, axis=0) / rest.var(axis=0))
