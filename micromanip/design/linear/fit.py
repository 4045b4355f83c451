"""``fit_linear``: a linear model of given or chosen order from recordings, judged by free run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .modal import Complex, Modes, decompose
from .regression import initial_state, refine, regress
from .subspace import Experiment, dynamics, observability

if TYPE_CHECKING:
    import control

Array = NDArray[np.float64]

_REFINEMENTS = 6
_LARGEST_ORDER = 12
_ENOUGH = 1.02
"""The smallest order whose held-out error is within this factor of the best one is chosen."""


@dataclass(frozen=True)
class LinearFit:
    """A model in physical units, sampled every `dt` seconds."""

    modes: Modes
    dt: float
    singular_values: Array
    offsets_u: Array
    offsets_y: Array

    @property
    def order(self) -> int:
        """Number of states."""
        return self.modes.order

    @property
    def poles(self) -> Complex:
        """All poles (n,), both of each pair."""
        pairs = self.modes.poles[self.modes.weights == 2.0]
        return np.concatenate([self.modes.poles, np.conj(pairs)])

    def simulate(self, u: Array, y: Array | None = None) -> Array:
        """Free run (n, outputs) over `u` (n, inputs); `y` (n, outputs) only gives the state at the start."""
        driven = u - self.offsets_u
        x0 = None if y is None else initial_state(self.modes, driven, y - self.offsets_y)
        return self.modes.simulate(driven, x0) + self.offsets_y

    def errors(self, u: Array, y: Array) -> tuple[Array, Array]:
        """Of the free run over a record: fit (percent, one an output) and rms error in percent of the output's rms.

        The offset is refitted, as always where another record, or another part of one, is predicted.
        """
        error, centred = y - self.simulate(u, y), y - y.mean(axis=0)
        error = error - error.mean(axis=0)
        size = np.sqrt((centred**2).mean(axis=0))
        rms = np.sqrt((error**2).mean(axis=0))
        return 100.0 * (1.0 - rms / size), 100.0 * rms / size

    def state_space(self) -> control.StateSpace:
        """The model for `control`."""
        import control

        return control.ss(*self.modes.state_space(), self.dt)


def fit_linear(
    experiments: Sequence[Experiment],
    dt: float,
    order: int | None = None,
    *,
    block_rows: int | None = None,
    direct: bool = True,
    refinements: int = _REFINEMENTS,
    progress: Callable[[str], None] = lambda _: None,
) -> LinearFit:
    """Linear model from experiments ``[(u (n, inputs), y (n, outputs)), ..]`` sampled every `dt` seconds.

    Without an `order` the smallest is taken whose free run on the last quarter of each experiment is within 2 %
    of the best up to order 12. Raises ValueError for records too short for the order.
    """
    pairs = [(_table(u), _table(y)) for u, y in experiments]
    offsets_u = np.mean(np.concatenate([u for u, _ in pairs]), axis=0)
    offsets_y = np.mean(np.concatenate([y for _, y in pairs]), axis=0)
    scale_u = np.std(np.concatenate([u for u, _ in pairs]), axis=0)
    scale_y = np.std(np.concatenate([y for _, y in pairs]), axis=0)
    if not (np.isfinite(scale_u).all() and np.isfinite(scale_y).all() and (scale_u > 0).all() and (scale_y > 0).all()):
        raise ValueError("every input and output must be finite and move")
    scaled = [((u - offsets_u) / scale_u, (y - offsets_y) / scale_y) for u, y in pairs]
    rows = block_rows or max(15, -(-3 * (order or _LARGEST_ORDER) // (2 * len(scale_y))))
    shortest = min(len(u) for u, _ in scaled)
    if shortest < 4 * rows * (len(scale_u) + 1):
        raise ValueError(
            f"an experiment of {shortest} samples is too short; at least {4 * rows * (len(scale_u) + 1)} are needed"
        )
    if order is None:
        order = _choose(scaled, rows, direct, progress)
    progress(f"subspace, order {order}")
    left, values = observability(scaled, rows)
    modes = _model(left, order, scaled, direct)
    progress("refining")
    modes = refine(modes, scaled, refinements, direct=direct)
    physical = Modes(modes.poles, modes.B / scale_u, modes.C * scale_y[:, None], modes.D * scale_y[:, None] / scale_u)
    return LinearFit(physical, dt, values, offsets_u, offsets_y)


def _table(signal: Array) -> Array:
    values = np.asarray(signal, dtype=float)
    return values[:, None] if values.ndim == 1 else values


def _model(left: Array, order: int, experiments: Sequence[Experiment], direct: bool) -> Modes:
    A, C = dynamics(left, order, experiments[0][1].shape[1])
    return regress(*decompose(A, C), experiments, direct=direct)


def _choose(experiments: Sequence[Experiment], rows: int, direct: bool, progress: Callable[[str], None]) -> int:
    """Order by the free run on what was left out."""
    fitted = [(u[: 3 * len(u) // 4], y[: 3 * len(u) // 4]) for u, y in experiments]
    left, _ = observability(fitted, rows)
    errors = {}
    for order in range(1, _LARGEST_ORDER + 1):
        progress(f"trying order {order}")
        modes = _model(left, order, fitted, direct)
        total = 0.0
        for u, y in experiments:
            x0 = initial_state(modes, u, y)
            total += float(np.sum((y - modes.simulate(u, x0))[3 * len(u) // 4 :] ** 2))
        errors[order] = total
    best = min(errors.values())
    return next(order for order, error in errors.items() if error <= _ENOUGH * _ENOUGH * best)
