"""Gains of the outer loop from its linear model and a few settings: stationary Kalman filter and LQG.

Augmented model per cycle, states in this order: n of the identified dynamics, the delayed set-points, one
random-walk disturbance and, where asked for, two of an oscillator, both entering with the set-point
after its delay:

    x+ = A x + B (u[k-d] + w + o),   y = C x

The regulator minimises ``sum y^2 + control_weight u^2`` on the controllable states. References and disturbances are
handled by the regulator equations ``Pi S = A Pi + B Gamma + E``, ``C Pi = C_ref``, so that they
are followed, or cancelled, without error in the model: ``u = -K x + (Gamma + K Pi) w``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cached_arrays import cached_arrays
from .predictor import block_diagonal, output_row, reference_transition, rotation
from .riccati import solve_riccati

if TYPE_CHECKING:
    from micromanip.settings.schema.axis import Outer
    from micromanip.settings.schema.reference import AxisTracker

Matrix = NDArray[np.float64]


class StationaryFilter(NamedTuple):
    """Gain (n,) per sample and what it follows from, as in ``OuterGains``."""

    observer: Matrix
    noise: Matrix
    covariance: Matrix
    innovation_variance: float


@dataclass(frozen=True)
class OuterGains:
    """The augmented model (n, n), (n,), (n,) and its gains, all per loop cycle."""

    A: Matrix
    B: Matrix
    C: Matrix
    observer: Matrix
    feedback: Matrix
    reference: Matrix
    steady_u: Matrix
    steady_y: Matrix
    noise: Matrix
    """Covariance (n, n) of what enters the states in a cycle."""
    covariance: Matrix
    """Of the stationary filter's estimate (n, n), just before a sample."""
    innovation_variance: float
    """Variance (um^2) of the stationary filter's innovation."""
    controllable: int
    """States that the actuator moves; they come first."""
    sample_cycles: int

    @property
    def closed_loop_poles(self) -> NDArray[np.complex128]:
        """Of the regulator per cycle, then of the observer per sample."""
        own, n = np.eye(len(self.A)), self.controllable
        regulator = self.A[:n, :n] - np.outer(self.B[:n], self.feedback[:n])
        sampled = np.linalg.matrix_power(self.A, self.sample_cycles)
        observer = (own - np.outer(self.observer, self.C)) @ sampled
        return np.concatenate([np.linalg.eigvals(regulator), np.linalg.eigvals(observer)])


def augment(outer: Outer, period_s: float) -> tuple[Matrix, Matrix, Matrix, int]:
    """Augmented ``A, B, C`` and the number of controllable states (they come first)."""
    a, b, c = (np.array(m, dtype=float) for m in (outer.model.A, outer.model.B, outer.model.C))
    n, delay = len(a), outer.model.delay_cycles
    controllable = n + delay
    oscillating = outer.oscillation_Hz is not None
    size = controllable + 1 + 2 * oscillating
    A, B, C = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    A[:n, :n], C[:n] = a, c
    if delay:
        A[:n, controllable - 1] = b
        A[range(n + 1, controllable), range(n, controllable - 1)] = 1.0
        B[n] = 1.0
    else:
        B[:n] = b
    A[:n, controllable] = b
    A[controllable, controllable] = 1.0
    if outer.oscillation_Hz is not None:
        omega = 2 * np.pi * outer.oscillation_Hz
        turn = rotation(omega, period_s)
        A[-2:, -2:] = np.array([[turn[0, 0], turn[0, 1] * omega], [turn[1, 0] / omega, turn[1, 1]]])
        A[:n, -2] = b
    return A, B, C, controllable


def stationary_filter(outer: Outer, A: Matrix, C: Matrix, controllable: int) -> StationaryFilter:
    """The Kalman filter of the augmented model for a sample every ``sample_cycles`` cycles."""
    noise = _process_noise(outer, A, controllable)
    step, total = np.eye(len(A)), np.zeros_like(noise)
    for _ in range(outer.sample_cycles):
        total = A @ total @ A.T + noise
        step = A @ step
    # a trace of noise on the delay states keeps the Riccati equation solvable: they are known exactly
    total += 1e-12 * np.eye(len(A))
    r = np.array([[outer.sensor_noise_um**2]])
    P = solve_riccati(step.T, C[:, None], total, r)
    variance = float(C @ P @ C + r[0, 0])
    return StationaryFilter(np.asarray(P @ C / variance, dtype=np.float64), noise, P, variance)


def _process_noise(outer: Outer, A: Matrix, controllable: int) -> Matrix:
    """Covariance (n, n) of what enters the augmented states in a cycle."""
    n = len(outer.model.A)
    noise = np.zeros((len(A), len(A)))
    b = np.array(outer.model.B, dtype=float)
    noise[:n, :n] = outer.input_noise_um**2 * np.outer(b, b)
    noise[controllable, controllable] = outer.disturbance_um**2
    for i in range(controllable + 1, len(A)):
        noise[i, i] = outer.oscillation_um**2
    return noise


def regulate(
    A: Matrix, B: Matrix, C: Matrix, controllable: int, weight: float, S: Matrix
) -> tuple[Matrix, Matrix, Matrix]:
    """LQR gain K (nc,), feedforward (nd,) of the disturbances and (r,) of the reference with transition `S`."""
    Ac, Bc, Cc = A[:controllable, :controllable], B[:controllable, None], C[:controllable]
    P = solve_riccati(Ac, Bc, np.outer(Cc, Cc), np.array([[weight]]))
    K = np.linalg.solve(Bc.T @ P @ Bc + weight, Bc.T @ P @ Ac)[0]
    E, D = A[:controllable, controllable:], A[controllable:, controllable:]
    exo = block_diagonal(D, S)
    forcing = np.hstack([E, np.zeros((controllable, len(S)))])
    target = np.zeros(len(exo))
    target[len(D) :] = output_row(len(S))
    m = len(exo)
    # unknowns: Pi column by column, then Gamma
    each, states = np.arange(m), m * controllable
    equations = np.zeros((states + m, states + m))
    dynamics = equations[:states, :states].reshape(m, controllable, m, controllable)
    dynamics += exo.T[:, None, :, None] * np.eye(controllable)[None, :, None, :]
    dynamics[each, :, each] -= Ac
    equations[:states, states:].reshape(m, controllable, m)[each, :, each] = -Bc[:, 0]
    equations[states:, :states].reshape(m, m, controllable)[each, each] = Cc
    solution = np.linalg.solve(equations, np.concatenate([forcing.T.ravel(), target]))
    Pi = solution[: m * controllable].reshape(m, controllable).T
    gain = solution[m * controllable :] + K @ Pi
    return K, gain[: len(D)], gain[len(D) :]


def outer_gains(outer: Outer, reference: AxisTracker | None, period_s: float) -> OuterGains:
    """All gains of one axis; `reference` has the oscillations to be followed, if any.

    Raises LinAlgError, ValueError or FloatingPointError where there are none.
    """
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        return _outer_gains(outer, reference, period_s)


def _outer_gains(outer: Outer, reference: AxisTracker | None, period_s: float) -> OuterGains:
    A, B, C, controllable = augment(outer, period_s)
    S = reference_transition(reference.oscillations if reference else (), period_s)
    K, disturbance, following = regulate(A, B, C, controllable, outer.control_weight, S)
    filtering = stationary_filter(outer, A, C, controllable)
    n = len(outer.model.A)
    b = np.array(outer.model.B, dtype=float)
    rest = np.linalg.solve(np.eye(n) - A[:n, :n], b)
    dc_gain = float(C[:n] @ rest)
    steady_u, steady_y = np.zeros(len(A)), np.zeros(len(A))
    steady_u[n:controllable], steady_u[controllable] = 1.0, -1.0
    steady_y[:n], steady_y[controllable] = rest / dc_gain, 1.0 / dc_gain
    feedback = np.concatenate([K, -disturbance])
    return OuterGains(
        A=A,
        B=B,
        C=C,
        **filtering._asdict(),
        feedback=feedback,
        reference=following,
        steady_u=steady_u,
        steady_y=steady_y,
        controllable=controllable,
        sample_cycles=outer.sample_cycles,
    )


def process_innovation(outer: Outer, gains: OuterGains, step_um: float, rise_cycles: int, time_cycles: int) -> float:
    """Largest mean square (um^2) of the innovation, over `time_cycles`, while the tool comes into contact.

    Its force is `step_um` in terms of the set-point, 95 % of it after `rise_cycles`, plus half of it as an oscillation
    at the tooth-passing frequency. The filter is that of `gains`, which does not expect it.
    """
    angle = 0.0 if outer.oscillation_Hz is None else math.acos(min(1.0, float(gains.A[-2, -2])))  # rad a cycle
    b = np.array(outer.model.B, dtype=float)
    filtered = gains.A, b, gains.C, gains.observer
    return _largest_innovation(*filtered, outer.sample_cycles, angle, step_um, rise_cycles, time_cycles)


@cached_arrays(16)
def _largest_innovation(
    A: Matrix, b: Matrix, C: Matrix, observer: Matrix, m: int, angle: float, step_um: float, rise: int, time: int
) -> float:
    """The same of a filter that takes a sample every `m` cycles, whose oscillator turns by `angle` (rad) in each."""
    samples = -(-(rise + 3 * time) // m)
    cycles = np.arange(samples * m)
    grown = step_um * -np.expm1(-3.0 * cycles / rise)
    if angle != 0.0:
        grown = grown + 0.5 * np.sign(grown) * step_um * np.sin(angle * cycles)
    pushes = np.zeros((len(A), m))  # what one cycle's push has become when the next sample is taken
    pushes[: len(b), -1] = b
    for j in range(m - 2, -1, -1):
        pushes[:, j] = A @ pushes[:, j + 1]
    step = np.linalg.matrix_power(A, m) @ (np.eye(len(A)) - np.outer(observer, C))
    seen = C[None, :]  # C F^k from sample to sample, twice as many each time
    while len(seen) < samples:
        seen, step = np.concatenate([seen, seen @ step]), step @ step
    innovation = np.zeros(samples)
    for j in range(m):
        innovation += _convolved(seen[:samples] @ pushes[:, j], grown[j::m])
    share = min(1.0, m / time)
    return float(_convolved(innovation**2, share * np.power(1.0 - share, np.arange(samples, dtype=np.float64))).max())


def _convolved(x: Matrix, y: Matrix) -> Matrix:
    """The beginning (n,) of the convolution of two (n,)."""
    size = 2 * len(x)
    return np.asarray(np.fft.irfft(np.fft.rfft(x, size) * np.fft.rfft(y, size), size)[: len(x)], dtype=np.float64)


def steady_lag(outer: Outer) -> float:
    """Cycles by which the stage lags a slow set-point: ``-G'(1) / G(1)`` of ``G = z^-d C (zI - A)^-1 B``."""
    a, b, c = (np.array(m, dtype=float) for m in (outer.model.A, outer.model.B, outer.model.C))
    once = np.linalg.solve(np.eye(len(a)) - a, b)
    return float(outer.model.delay_cycles + c @ np.linalg.solve(np.eye(len(a)) - a, once) / (c @ once))


def dc_gain(outer: Outer | None) -> float:
    """Steady stage position (um) per um of set-point; 1 without an outer loop, infinite for a model that integrates."""
    if outer is None:
        return 1.0
    model = outer.model
    a = np.array(model.A)
    try:
        return float(np.array(model.C) @ np.linalg.solve(np.eye(len(a)) - a, np.array(model.B)))
    except np.linalg.LinAlgError:
        return math.inf
