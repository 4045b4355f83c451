"""Recurrent-network models of the hysteresis (section 3.3) and of its inverse (section 3.4), trained in free run.

    X_k = [u_k, u_m, y_m],   y_k = w2^T sigma(W1 X_k + b1) + b2                                     (10)-(12)

Forward: u in volts, y in um. Inverse, the feedforward: u in um, y in volts. In the paper the memory ``(u_m, y_m)`` is
the sample before. Here it is the **last turning point** of u: the sample before u has come back by more than
`reversal` from its extreme. A smooth network cannot have one slope upwards and another downwards within one sample,
and what it makes of that depends on the sampling; but a branch that leaves a turning point is smooth, a function of u
alone, whatever the speed. Every branch begins at the memory point exactly, by tied weights (see network_training), so
that the output neither jumps when the memory moves nor drifts at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline

from micromanip.settings.schema.hysteresis import Network

from .training import Array, Course, mark_reversals, run_network


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
    """A trained network. Free-run errors are those of the training record after its burn-in, in the output's unit."""

    weights: Weights
    theta: Array
    course: Course
    scaling: Scaling
    reversal: float
    rms: float

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
        """The inverse, input um, output volts, as it stands in the configuration."""
        w = self.weights
        return Network(
            model="network",
            range_um=range_um,
            reversal_um=self.reversal,
            input_weights=tuple((float(a), float(b), float(c)) for a, b, c in w.w1),
            input_biases=tuple(float(value) for value in w.b1),
            output_weights=tuple(float(value) for value in w.w2),
            output_bias=w.b2,
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
