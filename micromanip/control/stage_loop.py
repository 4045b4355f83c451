"""The outer loop of one axis: Kalman filter and LQG as they run, around any plant from set-point to stage sensor.

With a sample every m cycles the loop is periodic; from sample to sample it is a time-invariant system, and that is
what is analysed: broken at the sensor, with the period of the samples. For m = 1 this is the loop broken at the
set-point, since both are single.

A cycle: ``x = A x + B u`` (filter), at a sample ``x += L (y - C x)``, then ``u = -K x``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .outer_gains import OuterGains
from .system import System, delay

if TYPE_CHECKING:
    from micromanip.settings.schema.axis import LinearModel


def model_system(model: LinearModel, period_s: float, extra_delay: float = 0.0) -> System:
    """The configuration's own plant, set-point (um) to stage (um), with its delay and `extra_delay` cycles."""
    dynamics = System(np.array(model.A), np.array(model.B), np.array(model.C), 0.0, period_s)
    return delay(model.delay_cycles + extra_delay, period_s).then(dynamics)


def stage_loop(gains: OuterGains, plant: System, sample_cycles: int = 1, late_cycles: int = 0) -> System:
    """Loop transfer for negative feedback, every `sample_cycles` cycles; `plant` must not feed through.

    A sample that arrives `late_cycles` after its measurement corrects the estimate of that time, so that of now by
    ``A^late L``, because the set-points since then are known.
    """
    if plant.D != 0.0:
        raise ValueError("the plant must not feed through: its output can't depend on the set-point of the same cycle")
    n, m = len(plant.A), len(gains.A)
    cycle = np.zeros((n + m, n + m))
    cycle[:n, :n], cycle[:n, n:] = plant.A, -np.outer(plant.B, gains.feedback)
    cycle[n:, n:] = gains.A - np.outer(gains.B, gains.feedback)
    if late_cycles:
        return _late_stage_loop(gains, plant, sample_cycles, late_cycles)
    corrected = np.eye(n + m)
    corrected[n:, n:] -= np.outer(gains.observer, gains.C)
    entering = np.concatenate([np.zeros(n), gains.observer])
    between = np.linalg.matrix_power(cycle, sample_cycles)
    output = np.concatenate([plant.C, np.zeros(m)])
    return System(between @ corrected, between @ entering, -output, 0.0, sample_cycles * plant.period_s)


def _late_stage_loop(gains: OuterGains, plant: System, sample_cycles: int, late_cycles: int) -> System:
    """The same with late samples; the states are plant, estimate of now, and the last outputs of both.

    The filter takes the innovation of the sample's own time, plant less estimate at that time. That estimate is the one
    before the sample's correction, predicted since by the same model and set-points as the present estimate: so a chain
    of past outputs contains it.
    """
    if late_cycles > sample_cycles:
        raise ValueError("a sample must have been seen before the next one is taken")
    n, m, k = len(plant.A), len(gains.A), late_cycles
    size = n + m + 2 * k
    cycle = np.zeros((size, size))
    cycle[:n, :n], cycle[:n, n : n + m] = plant.A, -np.outer(plant.B, gains.feedback)
    cycle[n : n + m, n : n + m] = gains.A - np.outer(gains.B, gains.feedback)
    for first, row, begin, width in ((n + m, plant.C, 0, n), (n + m + k, gains.C, n, m)):
        cycle[first, begin : begin + width] = row
        cycle[range(first + 1, first + k), range(first, first + k - 1)] = 1.0
    entering = np.zeros(size)
    entering[n : n + m] = np.linalg.matrix_power(gains.A, k) @ gains.observer
    corrected = np.eye(size)
    corrected[:, n + m + 2 * k - 1] -= entering
    output = np.zeros(size)
    output[n + m + k - 1] = 1.0
    between = np.linalg.matrix_power(cycle, sample_cycles)
    return System(between @ corrected, between @ entering, -output, 0.0, sample_cycles * plant.period_s)
