"""Fit of a recurrent network: starting weights, what it is trained on, and which start is taken.

Recurrent-network models of the hysteresis (section 3.3) and of its inverse (section 3.4), trained in free run.

    X_k = [u_k, u_m, y_m],   y_k = w2^T sigma(W1 X_k + b1) + b2                                     (10)-(12)

Forward: u in volts, y in um. Inverse, the feedforward: u in um, y in volts. In the paper the memory ``(u_m, y_m)`` is
the sample before. Here it is the **last turning point** of u: the sample before u has come back by more than
`reversal` from its extreme. A smooth network cannot have one slope upwards and another downwards within one sample,
and what it makes of that depends on the sampling; but a branch that leaves a turning point is smooth, a function of u
alone, whatever the speed. Every branch begins at the memory point exactly, by tied weights (see network_training), so
that the output neither jumps when the memory moves nor drifts at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline

from micromanip.control.system import Array
from micromanip.settings.schema.hysteresis import Network

from ...excitation import random_turns
from .training import Course, levenberg_marquardt, mark_reversals, run_network


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
class NetworkFit:
    """A trained network."""

    theta: Array
    course: Course
    scaling: Scaling
    reversal: float

    def moves(self, u: Array) -> NDArray[np.bool_]:
        """Samples (n,) of `u` (n,) after which the memory moves."""
        return reversals(u, self.reversal)

    def predict(self, u: Array, y0: float | None = None) -> Array:
        """Free run over `u` (n,), at any sampling, from the memory point ``(u[0], y0)``: outputs (n,).

        Without `y0` from the mean line of the training record's loop.
        """
        s, c = self.scaling, self.course
        us = np.ascontiguousarray((u - s.u_mean) / s.u_deviation)
        start = c.slope * us[0] if y0 is None else (y0 - s.y_mean) / s.y_deviation
        y = np.empty(len(us))
        run_network(self.theta, c.scale, us, self.moves(u), float(start), y)
        return y * s.y_deviation + s.y_mean

    def to_settings(self, range_um: tuple[float, float]) -> Network:
        """The inverse, input um, output volts, as it stands in the configuration.

        By (11)-(12) a pair becomes two neurons, the line one that stays next to sigma's turning point.
        """
        s, course = self.scaling, self.course
        p, q, g, b, w = self.theta[:-1].reshape(-1, 5).T
        q, g, line = q / course.width, g / course.step, float(self.theta[-1]) / course.step
        begins = np.stack([np.zeros_like(p), p - q * course.slope, q], axis=1)
        ends = begins + np.stack([g, -g, np.zeros_like(p)], axis=1)
        w1 = np.concatenate([ends, begins, [[NEAR_ZERO * line, -NEAR_ZERO * line, NEAR_ZERO]]])
        w1 /= np.array([s.u_deviation, s.u_deviation, s.y_deviation])
        b1 = np.concatenate([b, b, [0.0]]) - w1 @ np.array([s.u_mean, s.u_mean, s.y_mean])
        w2 = s.y_deviation * np.concatenate([w, -w, [4.0 / NEAR_ZERO]])
        return Network(
            model="network",
            range_um=range_um,
            reversal_um=self.reversal,
            input_weights=tuple((float(a), float(b), float(c)) for a, b, c in w1),
            input_biases=tuple(b1.tolist()),
            output_weights=tuple(w2.tolist()),
            output_bias=s.y_mean - 2.0 / NEAR_ZERO * s.y_deviation,
        )


def reversals(u: Array, reversal: float) -> NDArray[np.bool_]:
    """Samples (n,) after which the memory moves: those before `u` (n,) has come back by more than `reversal`."""
    moves = np.zeros(len(u), dtype=bool)
    mark_reversals(np.ascontiguousarray(u, dtype=float), reversal, moves)
    return moves


def smoothed(signal: Array) -> Array:
    """`signal` (n,) without its noise: the smoothing spline that generalised cross-validation chooses.

    The inverse has the measured displacement as its *input*: noise there would hide small turning points, and bias
    the slopes.
    """
    place = np.arange(len(signal), dtype=float)
    return np.asarray(make_smoothing_spline(place, signal)(place))


def white_noise(u: Array) -> float:
    """Standard deviation of white noise on a smooth signal (n,): what fourth differences leave of the movement."""
    return float(np.median(np.abs(np.diff(u, 4))) / 0.6745 / np.sqrt(70.0))


NEAR_ZERO = 1e-4
"""Input weights of the neuron that is the line: sigma is straight there to 1e-9, while rounding stays below 1e-11."""
START_OUTPUT = 0.1
"""Standard deviation of the pairs' output weights at the start, in widths of the loop."""
STAGES = ((1, 60), (5, 40), (20, 40))
"""Branches a free run lasts and evaluations of the cost, before the free run over the whole record."""
REVERSAL_SHARE, REVERSAL_NOISES = 0.001, 8.0
"""A turning point counts beyond this share of the input's span, and so many standard deviations of its noise."""
PAIRS = 12
"""Of neurons."""
SAMPLES = 4000
"""Samples of a record that are trained on; the turning points are found in all of them."""
_GRID = 2.0**24
UNSEEN_SAMPLES = 400
"""Length of the unseen course, two samples a branch."""


def _course(u: Array, y: Array, scaling: Scaling, moves: NDArray[np.bool_], burn_in: int) -> Course:
    # on a grid far finer than any sensor's digit: rounding must not depend on where a sensor has its zero
    us = np.rint((u - scaling.u_mean) / scaling.u_deviation * _GRID) / _GRID
    ys = np.rint((y - scaling.y_mean) / scaling.y_deviation * _GRID) / _GRID
    counted = slice(burn_in, None)
    slope = float(us[counted] @ ys[counted] / (us[counted] @ us[counted]))
    width = float(np.std((ys - slope * us)[counted]))
    weight = np.ones(len(us))
    weight[:burn_in] = 0.0
    used = np.arange(len(us)) % max(1, len(us) // SAMPLES) == 0
    used |= moves
    return Course(
        us[used],
        ys[used],
        moves[used],
        weight[used],
        step=float(np.std(np.diff(us[moves]))) if np.sum(moves) > 2 else 1.0,
        slope=slope,
        width=max(width, 1e-6),
    )


def _start(rng: np.random.Generator, course: Course) -> Array:
    """Normally distributed weights; the line starts as the slope between the two signals."""
    rows = rng.standard_normal((PAIRS, 5))
    rows[:, 4] *= START_OUTPUT * course.width
    return np.append(rows.ravel(), course.slope * course.step)


def _strays(fit: NetworkFit, u: Array, y: Array) -> bool:
    """Whether a free run over unseen turning points, within `u`'s range, leaves the range of `y` by a tenth."""
    course = random_turns(float(u.min()), float(u.max()), np.inf, 1.0, UNSEEN_SAMPLES, seed=0)
    middle, reach = 0.5 * (float(y.max()) + float(y.min())), 0.6 * float(np.ptp(y))
    return bool(np.abs(fit.predict(course, middle) - middle).max() > reach)


def fit_network(
    u: Array,
    y: Array,
    *,
    starts: int = 8,
    seed: int = 0,
    burn_in: int = 0,
    evaluations: int = 300,
    progress: Callable[[str], None] | None = None,
) -> NetworkFit:
    """Train a network for output `y` (n,) from input `u` (n,).

    Best of `starts`, seeded, each trained on single branches first and in ever longer free runs after that; one that
    runs away on a course it has not seen is no choice while another does not. The first `burn_in` samples do not
    count. Raises ValueError for arrays that differ in length.
    """
    if len(u) != len(y):
        raise ValueError(f"input and output must be equally long, not {len(u)} and {len(y)} samples")
    reversal = max(REVERSAL_SHARE * float(np.ptp(u)), REVERSAL_NOISES * white_noise(u))
    scaling = Scaling.of(u, y)
    course = _course(u, y, scaling, reversals(u, reversal), burn_in)
    rng = np.random.default_rng(seed)
    trained = []
    for number in range(starts):
        theta = _start(rng, course)
        for segment, most in (*STAGES, (0, evaluations)):
            theta = levenberg_marquardt(theta, course, segment, most)
        fit = NetworkFit(theta, course, scaling, reversal)
        rms = float(np.sqrt(np.mean((fit.predict(u) - y)[burn_in:] ** 2)))
        trained.append((_strays(fit, u, y), rms, number, fit))
        if progress is not None:
            progress(f"start {number + 1} of {starts}: free-run error {rms:.4g} rms")
    return min(trained)[-1]
