"""The tracker's predictor as a linear model: how its state moves on, and the gain of its stationary Kalman filter.

State ``[p, v, a, o1, o1', ..]``: position with white jerk, and oscillations whose amplitudes walk, and decay if
configured (``rt/laws/reference.py`` runs it). A path that returns is one whose position swings slowly about a constant:
at each sample the acceleration goes against the rate (``rt/laws/predictor.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .riccati import solve_riccati

if TYPE_CHECKING:
    from micromanip.settings.schema.reference import AxisTracker, Oscillation

Matrix = NDArray[np.float64]

_PATH_OMEGA = 50.0
"""rad/s: in units of it position, velocity and acceleration are of like size."""


class Predictor(NamedTuple):
    """A stationary filter: gain (r,), variance of the innovations, and variances (oscillations,) of each one's o and
    o' over its frequency, both, after a sample; um^2.
    """

    gain: Matrix
    innovation_um2: float
    swings_um2: Matrix


def rotation(omega: float, period_s: float) -> Matrix:
    """Transition over one period of an oscillation's (value, rate)."""
    s, c = np.sin(omega * period_s), np.cos(omega * period_s)
    return np.array([[c, s / omega], [-omega * s, c]])


def reference_transition(oscillations: Sequence[Oscillation], period_s: float) -> Matrix:
    """Transition of the predictor's state (r, r) over one period."""
    h = period_s
    moving = np.array([[1.0, h, h * h / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    turns = (np.exp(-o.decay_per_s * h) * rotation(2 * np.pi * o.frequency_Hz, h) for o in oscillations)
    return block_diagonal(moving, *turns)


def sample_transition(reference: AxisTracker, period_s: float) -> Matrix:
    """Transition (r, r) from one sample to the next; of a path that returns it is not quite that between them."""
    step = reference_transition(reference.oscillations, period_s)
    step[2] -= (2 * np.pi * reference.returns_Hz) ** 2 * period_s * step[1]
    return step


def output_row(states: int) -> Matrix:
    """What a sample shows of the state (r,): position and every oscillation."""
    row = np.zeros(states)
    row[0] = 1.0
    row[3::2] = 1.0
    return row


def tracker_gain(reference: AxisTracker) -> Matrix:
    """Stationary Kalman gain (r,) of the reference's predictor at the signal's own rate.

    Raises LinAlgError, ValueError or FloatingPointError where there is none.
    """
    return stationary(reference).gain


def stationary(reference: AxisTracker) -> Predictor:
    """The whole of it; raises as `tracker_gain`."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        return _stationary(reference)


def _stationary(reference: AxisTracker) -> Predictor:
    h = 1.0 / reference.sample_rate_Hz
    F = sample_transition(reference, h)
    moving = np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]])
    blocks, scale = [reference.jerk_um_per_s3**2 * moving], [1.0, _PATH_OMEGA, _PATH_OMEGA**2]
    for each in reference.oscillations:
        # the amplitude walks by um_per_s per root second, in both states
        omega, time_s = 2 * np.pi * each.frequency_Hz, _walked(each.decay_per_s, h)
        blocks.append(each.um_per_s**2 * np.diag([1.0, omega**2]) * time_s)
        scale += [1.0, omega]
    # in units in which all states are of like size: the plain equation is too badly scaled
    units, H = np.array(scale), output_row(len(F))
    Fs, Qs = F * units[None, :] / units[:, None], block_diagonal(*blocks) / np.outer(units, units)
    P = solve_riccati(Fs.T, H[:, None], Qs, np.array([[reference.noise_um**2]]))
    variance = float(H @ P @ H + reference.noise_um**2)
    left = np.diag(P) - (P @ H) ** 2 / variance
    return Predictor(np.asarray(units * (P @ H) / variance, dtype=np.float64), variance, left[3::2] + left[4::2])


def _walked(decay_per_s: float, time_s: float) -> float:
    """Integral of ``exp(-2 decay t)`` over `time_s`: the time for which a decaying state has walked."""
    return float(-np.expm1(-2.0 * decay_per_s * time_s) / (2.0 * decay_per_s)) if decay_per_s > 0.0 else time_s


def block_diagonal(*blocks: Matrix) -> Matrix:
    """Square blocks along the diagonal."""
    total, at = np.zeros((sum(map(len, blocks)),) * 2), 0
    for block in blocks:
        total[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return total
