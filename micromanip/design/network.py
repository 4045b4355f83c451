"""Recurrent-network models of the hysteresis (section 3.3) and of its inverse (section 3.4), trained in free run.

    X_k = [u_k, u_m, y_m],   y_k = w2^T sigma(W1 X_k + b1) + b2                                     (10)-(12)

Forward: u in volts, y in um. Inverse, the feedforward: u in um, y in volts. The memory point ``(u_m, y_m)`` is the one
before, as in the paper, or, with `every` > 1, moves on every so many samples, while the output is trained at all of
them. So it is used in the loop, which runs faster than any record is sampled: the network has to be right on the whole
branch that leaves the memory point, not only at its end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from micromanip.settings.hysteresis import Network

from .network_training import Array, Course, Flags, levenberg_marquardt

LINEAR_RANGE = 1e-4
"""Input weight, relative, of the neuron that starts as the linear part of the model: sigma is a line so near to 0."""
START_OUTPUT = 0.05
"""Standard deviation of the other output weights at the start, in widths of the loop."""
STAGES = ((1, 40), (10, 40), (100, 40))
"""Memory moves a free run lasts and evaluations of the cost, before the free run over the whole record."""


@dataclass(frozen=True)
class Scaling:
    """From physical to training units, ``(value - mean) / deviation``, of input and output."""

    u_mean: float
    u_deviation: float
    y_mean: float
    y_deviation: float

    @classmethod
    def of(cls, u: Array, y: Array) -> Scaling:
        """That which gives `u` and `y` (n,) mean 0 and standard deviation 1."""
        return cls(float(np.mean(u)), float(np.std(u)), float(np.mean(y)), float(np.std(y)))


@dataclass(frozen=True)
class Weights:
    """Weights in physical units: `w1` (M, 3) for [u_k, u_m, y_m], `b1` (M,), `w2` (M,), `b2`."""

    w1: Array
    b1: Array
    w2: Array
    b2: float


@dataclass(frozen=True)
class NetworkFit:
    """A trained network; its memory moves every `every` samples of `sample_s` seconds."""

    weights: Weights
    sample_s: float
    every: int
    rms: float
    """Free-run error over the training record, after the burn-in, in the output's unit."""
    costs: tuple[float, ...]
    """Final free-run error, as `rms`, of every start."""

    @property
    def period_s(self) -> float:
        """Interval at which the memory moves."""
        return self.every * self.sample_s

    def predict(self, u: Array, y0: float) -> Array:
        """Free run over `u` (n,), sampled at `sample_s`, from the memory point ``(u[0], y0)``: outputs (n,)."""
        y, u_memory, y_memory, w = np.empty(len(u)), float(u[0]), y0, self.weights
        for k, moves in enumerate(_moves(len(u), self.every)):
            X = np.array([u[k], u_memory, y_memory])
            y[k] = w.w2 @ (1.0 / (1.0 + np.exp(-(w.w1 @ X + w.b1)))) + w.b2
            if moves:
                u_memory, y_memory = float(u[k]), float(y[k])
        return y

    def one_step(self, u: Array, y: Array) -> Array:
        """Outputs (n,) for `u` (n,) with the memory on the measured `y` (n,): teacher forced."""
        last = np.maximum(0, (np.arange(len(u)) - 1) // self.every * self.every)
        X = np.stack([u, u[last], y[last]], axis=1)
        Z = 1.0 / (1.0 + np.exp(-(X @ self.weights.w1.T + self.weights.b1)))
        return np.asarray(Z @ self.weights.w2 + self.weights.b2)

    def to_settings(self, range_um: tuple[float, float]) -> Network:
        """The inverse, input um, output volts, as it stands in the configuration."""
        w = self.weights
        return Network(
            model="network",
            range_um=range_um,
            period_ms=self.period_s * 1e3,
            input_weights=tuple((float(a), float(b), float(c)) for a, b, c in w.w1),
            input_biases=tuple(float(value) for value in w.b1),
            output_weights=tuple(float(value) for value in w.w2),
            output_bias=w.b2,
        )


def _moves(samples: int, every: int) -> Flags:
    return np.asarray(np.arange(samples) % every == 0)


def _course(u: Array, y: Array, scaling: Scaling, every: int, burn_in: int) -> Course:
    us = (u - scaling.u_mean) / scaling.u_deviation
    ys = (y - scaling.y_mean) / scaling.y_deviation
    slope = float(us @ ys / (us @ us))
    weight = np.ones(len(us))
    weight[:burn_in] = 0.0
    return Course(
        us,
        ys,
        _moves(len(us), every),
        weight,
        step=float(np.std(us[every:] - us[:-every])),
        slope=slope,
        width=max(float(np.std(ys - slope * us)), 1e-6),
    )


def _start(rng: np.random.Generator, neurons: int, course: Course) -> Array:
    """Normally distributed weights; the line starts as the slope between the two signals."""
    rows = rng.standard_normal((neurons // 2, 5))
    rows[:, 4] *= START_OUTPUT * course.step
    return np.append(rows.ravel(), course.slope * course.step)


def _physical(theta: Array, course: Course, scaling: Scaling) -> Weights:
    """Weights of (11)-(12): a pair becomes two neurons, the line one that stays next to sigma's turning point."""
    p, q, g, b, w = theta[:-1].reshape(-1, 5).T
    q, g, line = q / course.width, g / course.step, theta[-1] / course.step
    zero = np.zeros_like(p)
    ends = np.stack([g, p - q * course.slope - g, q], axis=1)
    begins = np.stack([zero, p - q * course.slope, q], axis=1)
    w1 = np.concatenate([ends, begins, [[LINEAR_RANGE * line, -LINEAR_RANGE * line, LINEAR_RANGE]]])
    b1 = np.concatenate([b, b, [0.0]])
    w2 = np.concatenate([w, -w, [4.0 / LINEAR_RANGE]])
    deviations = np.array([scaling.u_deviation, scaling.u_deviation, scaling.y_deviation])
    w1 = w1 / deviations
    w2 = scaling.y_deviation * w2
    b1 = b1 - w1 @ np.array([scaling.u_mean, scaling.u_mean, scaling.y_mean])
    return Weights(w1, b1, w2, float(scaling.y_mean - 2.0 / LINEAR_RANGE * scaling.y_deviation))


def fit_network(
    u: Array,
    y: Array,
    dt: float,
    *,
    neurons: int = 25,
    every: int = 1,
    samples: int = 6500,
    starts: int = 2,
    seed: int = 0,
    burn_in: int = 0,
    iterations: int = 150,
    ridge: float = 1e-5,
    smooth: int = 1,
    progress: Callable[[str], None] | None = None,
) -> NetworkFit:
    """Train on input `u` and output `y` (n,), sampled every `dt` seconds; the best of some starts.

    Long records are thinned to about `samples`; the network's sampling is then coarser. The first `burn_in`
    samples (of the record) do not count. `every`, `ridge`: see above and ``levenberg_marquardt``.
    """
    if smooth > 1:
        from scipy.signal import savgol_filter

        u = savgol_filter(u, smooth, 2)
    decimation = max(1, -(-len(u) // samples))
    u, y, burn_in = np.ascontiguousarray(u[::decimation]), np.ascontiguousarray(y[::decimation]), burn_in // decimation
    scaling = Scaling.of(u, y)
    course = _course(u, y, scaling, every, burn_in)
    rng = np.random.default_rng(seed)
    trained = []
    for number in range(starts):
        theta = _start(rng, neurons, course)
        for segment, evaluations in (*STAGES, (0, iterations)):
            theta = levenberg_marquardt(theta, course, segment, evaluations, ridge)
        left = NetworkFit(_physical(theta, course, scaling), dt * decimation, every, 0.0, ())
        rms = float(np.sqrt(np.mean((left.predict(u, y[0]) - y)[burn_in:] ** 2)))
        trained.append((rms, left.weights))
        if progress is not None:
            progress(f"start {number + 1} of {starts}: free-run error {rms:.4g} rms")
    rms, weights = min(trained, key=lambda entry: entry[0])
    return NetworkFit(weights, dt * decimation, every, rms, tuple(entry[0] for entry in trained))
