"""Models of each axis for `difference`: two of the recording's configuration, and an actuator fitted to its rows.

The actuator P is an autoregression with the free displacement H[V] as input, by least squares,

    strain[k] = sum_j a_j strain[k-j] + sum_j b_j free[k-j] + offset + tooth passing,     j = 1 .. 12

In a closed loop that is consistent: at least one cycle lies between a voltage and its answer, and the gauge's own
noise, which the PID feeds back over the whole band, excites it (Ljung, System Identification, 13.4, the direct method).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from micromanip.control.pid import pid_system
from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.rt.jit import Compiler
from micromanip.rt.laws.feedforward import PRANDTL_ISHLINSKII
from micromanip.rt.laws.hysteresis import IDENTITY, model_output
from micromanip.rt.record import MAX_AXES
from micromanip.rt.signatures import array_of
from micromanip.rt.telemetry import STRAIN_FRESH
from micromanip.settings.schema.axis import Axis, Outer
from micromanip.settings.schema.model import Configuration

from .difference import DIFFERENCE_MODEL, DIFFERENCE_STATE, ORDER, PLAYS_MODEL
from .window import Window

_MOST_ROWS = 30_000
_FRESH_SHARE = 0.98
_STABLE = 0.9995
"""Largest pole of an actuator that is believed."""
_STAGE = np.array([0.02, 0.01, 0.10, 0.25])
_COUPLING = 0.015
"""Standard deviations of the stage's model: of its gain, the frequencies of its modes and their damping as shares, of
its delay in cycles, and of what it sees of the other axes, which the model as it is leaves out."""
_TRIES = 20

compiled = Compiler(__file__, allocates=True)


@dataclass(frozen=True)
class Actuator:
    """P of one axis: weights (2 ORDER,), first of the past strain, and the Cholesky factor (lower) of their
    covariance.
    """

    weights: Array
    spread: Array

    def drawn(self, random: np.random.Generator, spread: float = 1.0) -> Array:
        """Other weights that the recording allows, stable ones."""
        for _ in range(_TRIES):
            weights = self.weights + spread * self.spread @ random.standard_normal(2 * ORDER)
            if _largest_pole(weights) < _STABLE:
                return weights
        return self.weights


@dataclass(frozen=True)
class Models:
    """Models of all axes, with the state (MAX_AXES,) that they begin in, as `replay_rows` takes them.

    `free_um` (n, MAX_AXES) are their free displacements under the voltages of the window.
    """

    nominal: NDArray[Any]
    begin: NDArray[Any]
    free_um: Array
    actuators: list[Actuator]

    def drawn(self, seed: int, spread: float = 1.0) -> NDArray[Any]:
        """Models (MAX_AXES,) as they might be too, by `spread` times the standard deviations above."""
        random = np.random.default_rng(seed)
        models = self.nominal.copy()
        for i, (m, actuator) in enumerate(zip(models, self.actuators, strict=False)):
            m["coupling"] = spread * _COUPLING * random.standard_normal(MAX_AXES)
            m["coupling"][i] = 1.0
            m["strain"], m["free"] = np.split(actuator.drawn(random, spread), 2)
            gain, frequency, damping, late = spread * random.standard_normal(4) * _STAGE
            n = int(m["states"])
            A, B = _changed(m["A"][:n, :n], m["B"][:n], frequency, damping)
            other = np.linalg.inv(A) if late > 0.0 else A  # the output of the cycle before, or of the next
            part = min(abs(late), 1.0)
            m["A"][:n, :n], m["B"][:n] = A, B
            m["C"][:n] = (1.0 + gain) * (m["C"][:n] @ ((1.0 - part) * np.eye(n) + part * other))
        return models


def fit_models(window: Window, configuration: Configuration) -> Models:
    """Models for the differences to `window`, whose configuration is given.

    Raises CheckFailed where a gauge is not fresh in nearly every cycle, or the rows tell too little of an actuator.
    """
    models, begin = np.zeros(MAX_AXES, DIFFERENCE_MODEL), np.zeros(MAX_AXES, DIFFERENCE_STATE)
    actuators, free_um = [], np.zeros((len(window.rows), MAX_AXES))
    for i, (name, axis) in enumerate(configuration.axes.items()):
        if axis.outer is None:
            raise CheckFailed(f"{window.file}: axis {name} has no model of its stage (outer.model) in the recording")
        rows, m = window.rows["axis"][:, i], models[i]
        fresh = float(np.mean(rows["fresh"][window.first :] & STRAIN_FRESH != 0))
        if fresh < _FRESH_SHARE:
            raise CheckFailed(
                f"{window.file}: the gauge of axis {name} is fresh in {100 * fresh:.0f} % of the cycles; its actuator "
                "can't be fitted to samples that are rare"
            )
        m["present"] = m["coupling"][i] = 1
        _fill_hysteresis(m["hysteresis"], begin[i], window, i)
        free = np.empty(len(rows))
        voltage = np.ascontiguousarray(rows["voltage_V"])
        displacements(models["hysteresis"][i : i + 1].copy(), begin[i]["plays"].copy(), voltage, free)
        free_um[:, i] = free
        seen = slice(max(window.first, len(rows) - _MOST_ROWS), None)
        actuator = _fit_actuator(
            rows["strain_um"][seen], free[seen], axis.outer.oscillation_Hz, window.period_ns * 1e-9
        )
        if actuator is None:
            raise CheckFailed(
                f"{window.file}: the actuator of axis {name} can't be fitted: the rows show too little of how it "
                "moves; take a longer piece, in which the stage follows its path"
            )
        actuators.append(actuator)
        m["strain"], m["free"] = np.split(actuator.weights, 2)
        change = np.diff(voltage)
        _fill_loop(m, axis, float(np.diff(free) @ change / (change @ change)), window.period_ns * 1e-9)
        _fill_stage(m, axis.outer)
    return Models(models, begin, free_um, actuators)


def _fill_hysteresis(h: Any, s: Any, window: Window, i: int) -> None:
    """The model that the recording's feedforward inverts, its plays where they stood; a line where it has none."""
    feedforward = window.parameters[0]["axis"][i]["hysteresis"]
    if feedforward["kind"] != PRANDTL_ISHLINSKII:
        rows = window.rows["axis"][:, i]
        h["alpha"], h["shaping"]["kind"] = np.polyfit(rows["voltage_V"], rows["strain_um"], 1)[0], IDENTITY
        return
    for name in h.dtype.names:
        h[name] = feedforward[name]
    z, after = window.state[0]["axis"][i]["hysteresis"]["z"], 0.0
    partial = float(h["alpha"] + h["rho"].sum())
    for k in range(int(h["plays"]) - 1, -1, -1):  # `rt.laws.hysteresis.inverse_state`, solved for the model
        s["plays"][k] = (z[k] - after) / partial
        after += h["rho"][k] * s["plays"][k]
        partial -= float(h["rho"][k])


def _fit_actuator(strain: Array, free: Array, tooth_Hz: float | None, period_s: float) -> Actuator | None:
    """Least squares over rows (n,); None where they don't tell the weights, or tell weights that are not stable."""
    count = len(strain) - ORDER
    turn = 2.0 * np.pi * (tooth_Hz or 0.0) * period_s * np.arange(count)
    known = [np.ones(count)] + ([np.sin(turn), np.cos(turn)] if tooth_Hz else [])
    past = [signal[ORDER - j : len(signal) - j] for signal in (strain, free) for j in range(1, ORDER + 1)]
    X, y = np.stack([*past, *known], axis=1), strain[ORDER:]
    try:
        factor = cholesky(X.T @ X, lower=True)
    except np.linalg.LinAlgError:
        return None
    found = cho_solve((factor, True), X.T @ y)
    residual_um = float(np.sqrt(np.mean((y - X @ found) ** 2)))
    weights = found[: 2 * ORDER]
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
    covariance = residual_um**2 * (inverse.T @ inverse)[: 2 * ORDER, : 2 * ORDER]
    if not np.isfinite(weights).all() or _largest_pole(weights) >= _STABLE:
        return None
    return Actuator(weights, np.asarray(np.linalg.cholesky(covariance), dtype=float))


def _largest_pole(weights: Array) -> float:
    return float(np.abs(np.roots(np.concatenate([[1.0], -weights[:ORDER]]))).max())


def _fill_loop(m: Any, axis: Axis, slope_um_per_V: float, period_s: float) -> None:
    """The recording's feedforward and PID."""
    m["feedforward"] = 0.0 if axis.inner.mode == "pid" else 1.0
    if axis.inner.mode == "feedforward":
        return
    pid = pid_system(axis.running_inner, period_s).scaled(slope_um_per_V)
    n = len(pid.A)
    m["pid_A"][:n, :n], m["pid_B"][:n], m["pid_C"][:n], m["pid_D"] = pid.A, pid.B, pid.C, pid.D


def _fill_stage(m: Any, outer: Outer) -> None:
    n = len(outer.model.A)
    m["states"], m["delay"] = n, outer.model.delay_cycles
    m["A"][:n, :n], m["B"][:n], m["C"][:n] = outer.model.A, outer.model.B, outer.model.C


def _changed(A: Array, B: Array, frequency: float, damping: float) -> tuple[Array, Array]:
    """The modes moved by shares of their frequency and damping, the steady gain of each kept."""
    values, vectors = np.linalg.eig(A)
    logarithms = (1.0 + frequency) * np.log(values.astype(complex))
    moved = np.exp(logarithms.real * (1.0 + damping) + 1j * logarithms.imag)
    back = np.linalg.inv(vectors)
    gains = (1.0 - moved) / (1.0 - values)
    return (vectors * moved @ back).real, (vectors * gains @ back @ B).real


@compiled.entry(types.void(array_of(PLAYS_MODEL), types.float64[::1], types.float64[::1], types.float64[::1]))
def displacements(model: Any, plays: Any, voltage: Any, free: Any) -> None:
    """Free displacement (n,) of `model` (1,) under `voltage` (n,); advances `plays`."""
    for k in range(len(voltage)):
        free[k] = model_output(model[0], plays, voltage[k])
