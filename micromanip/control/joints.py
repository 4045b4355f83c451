"""Parameters for following the joints' frequencies: the gains of the loops, and whether the predictor stays stable.

The law is ``micromanip/rt/laws/frequency_lock.py``.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .predictor import Matrix, block_diagonal, output_row, sample_transition, stationary, tracker_gain

if TYPE_CHECKING:
    from micromanip.settings.schema.reference import AxisTracker

_PULL, _ACROSS_S, _FLOOR_SIGMA = 1.0, 0.1, 4.0
"""Share of the lead that is taken up, over the share of the error that a sample removes, of a lone oscillation: a
damping of .5 by its slowest pole, and more by the others. Beside others less: they disturb one another. From the
configured frequency to the upper end of its range at the fastest. Amplitude that is followed."""


class FollowedJoints(NamedTuple):
    """Fields of the law's parameters, by their names: one number for each oscillation."""

    detuning_low: Matrix
    detuning_high: Matrix
    detuning_pull: Matrix
    detuning_slew: Matrix
    swing_floor_um2: Matrix


def followed_joints(reference: AxisTracker) -> FollowedJoints:
    """Figures of the law for the predictor of `reference`; raises as ``tracker_gain``."""
    low, high = detunings(reference)
    steps = reference.sample_rate_Hz
    pull = _PULL * steps * removed(reference) / max(1, len(high))
    return FollowedJoints(
        low, high, pull, high / (_ACROSS_S * steps), _FLOOR_SIGMA**2 * stationary(reference).swings_um2
    )


def detunings(reference: AxisTracker) -> tuple[Matrix, Matrix]:
    """Ends (oscillations,) of the ranges, rad/s from the configured frequencies."""
    hertz = np.array([(each.frequency_Hz, *each.range_Hz) for each in reference.oscillations]).reshape(-1, 3)
    configured, low, high = 2.0 * math.pi * hertz.T
    return low - configured, high - configured


def removed(reference: AxisTracker) -> Matrix:
    """Share (oscillations,) of each one's error that a sample removes: 1 less the radius of its pole."""
    poles = _poles(reference, sample_transition(reference, 1.0 / reference.sample_rate_Hz))
    own = [
        np.exp((-each.decay_per_s + 2j * math.pi * each.frequency_Hz) / reference.sample_rate_Hz)
        for each in reference.oscillations
    ]
    nearest = np.array([poles[np.argmin(np.abs(poles - each))] for each in own])
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(nearest)), dtype=np.float64)


def joints_radius(reference: AxisTracker) -> float:
    """Largest pole of the predictor, each frequency being as configured or at an end of its range."""
    step_s = 1.0 / reference.sample_rate_Hz
    step, (low, high) = sample_transition(reference, step_s), detunings(reference)
    largest = 0.0
    for found in itertools.product(*(sorted({0.0, *ends}) for ends in zip(low, high, strict=True))):
        turns = [
            _turn(2.0 * math.pi * each.frequency_Hz, detuning, step_s)
            for each, detuning in zip(reference.oscillations, found, strict=True)
        ]
        largest = max(largest, float(np.abs(_poles(reference, block_diagonal(np.eye(3), *turns) @ step)).max()))
    return largest


def _turn(omega: float, detuning: float, period_s: float) -> Matrix:
    """What an oscillation of `omega` turns by beyond that, in its own units (value, rate at `omega`)."""
    c, s = math.cos(detuning * period_s), math.sin(detuning * period_s)
    return np.array([[c, s / omega], [-omega * s, c]])


def _poles(reference: AxisTracker, step: Matrix) -> Matrix:
    gain = tracker_gain(reference)
    return np.asarray(np.linalg.eigvals((np.eye(len(gain)) - np.outer(gain, output_row(len(gain)))) @ step))
