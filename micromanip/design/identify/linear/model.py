"""The fitted model: free run, errors, and `control.StateSpace`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from micromanip.control.system import Array, Complex

from .modal import Experiment, Modes
from .regression import start

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class LinearFit:
    """A model in physical units, sampled every `dt` seconds; input i acts `delays[i]` samples late.

    `tried` tells for each order that was tried the held-out rms error, percent of the outputs'; `mirrored` are poles
    (k,) that the record has outside the unit circle, and the model inside.
    """

    modes: Modes
    dt: float
    delays: tuple[int, ...]
    offsets_u: Array
    offsets_y: Array
    singular_values: Array
    tried: dict[int, float]
    mirrored: tuple[complex, ...] = ()

    @property
    def order(self) -> int:
        """Number of states, without those of the delays."""
        return self.modes.order

    @property
    def poles(self) -> Complex:
        """All poles (n,) in z, both of each pair, without those of the delays (which are 0)."""
        pairs = self.modes.poles[self.modes.weights == 2.0]
        return np.concatenate([self.modes.poles, np.conj(pairs)])

    def simulate(self, u: Array, y: Array | None = None) -> Array:
        """Free run (n, outputs) over `u` (n, inputs), from rest; or from state and offset that explain `y` best.

        The samples before the longest delay depend on inputs before the record: with `y` (n, outputs) they are its
        own, otherwise the first input is taken to have been there before.
        """
        u, first = as_columns(u), max(self.delays)
        if y is None:
            held = np.vstack([np.repeat(u[:1], first, axis=0), u])
            driven, _ = delayed((held - self.offsets_u, held), self.delays)
            return self.modes.simulate(driven) + self.offsets_y
        y = as_columns(y)
        driven, measured = delayed((u - self.offsets_u, y), self.delays)
        return np.vstack([y[:first], start(self.modes, driven, measured).run(self.modes, driven)])

    def errors(self, u: Array, y: Array) -> tuple[Array, Array]:
        """Of the free run: fit (percent) and rms error in percent of the output's rms, both (outputs,).

        State and offset at the start are fitted, as is usual for a record that the model has never seen.
        """
        y, first = as_columns(y), max(self.delays)
        error = (y - self.simulate(u, y))[first:]
        size = np.sqrt(((y - y.mean(axis=0))[first:] ** 2).mean(axis=0))
        rms = 100.0 * np.sqrt((error**2).mean(axis=0)) / size
        return 100.0 - rms, rms

    def state_space(self) -> control.StateSpace:
        """The model, its delays as states after those of the dynamics, for `control`."""
        import control

        A, B, C, D = self.modes.state_space()
        n, m, late = len(A), len(self.delays), sum(self.delays)
        whole = np.zeros((n + late, n + late))
        drive, show, direct = np.zeros((n + late, m)), np.zeros((len(C), n + late)), D.copy()
        whole[:n, :n], show[:, :n] = A, C
        at = n
        for i, delay in enumerate(self.delays):
            if delay == 0:
                drive[:n, i] = B[:, i]
                continue
            # the oldest set-point stands first: it drives the dynamics
            whole[:n, at], show[:, at], direct[:, i] = B[:, i], D[:, i], 0.0
            whole[range(at, at + delay - 1), range(at + 1, at + delay)] = 1.0
            drive[at + delay - 1, i] = 1.0
            at += delay
        return control.ss(whole, drive, show, direct, self.dt)


def as_columns(signal: Array) -> Array:
    """A signal (n,) or (n, channels) as (n, channels)."""
    values = np.asarray(signal, dtype=float)
    return values[:, None] if values.ndim == 1 else values


def delayed(experiment: Experiment, delays: tuple[int, ...]) -> Experiment:
    """Inputs as they act, and outputs, from the first sample at which all inputs are known."""
    u, y = experiment
    first = max(delays)
    return np.column_stack([u[first - d : len(u) - d, i] for i, d in enumerate(delays)]), y[first:]


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
