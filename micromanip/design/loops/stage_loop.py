"""The outer loop of one axis: Kalman filter and LQG as they run, around any plant from set-point to stage sensor.

With a sample every m cycles the loop is periodic; from sample to sample it is a time-invariant system, and that is
what is analysed: broken at the sensor, with the period of the samples. For m = 1 this is the loop broken at the
set-point, since both are single.

A cycle: ``x = A x + B u`` (filter), at a sample ``x += L (y - C x)``, then ``u = -K x``.
"""

from __future__ import annotations

import numpy as np

from micromanip.settings.axis import LinearModel
from micromanip.settings.outer import OuterGains

from .system import System, delay


def model_system(model: LinearModel, period_s: float, extra_delay: float = 0.0) -> System:
    """The configuration's own plant, set-point (um) to stage (um), with its delay and `extra_delay` cycles."""
    dynamics = System(np.array(model.A), np.array(model.B), np.array(model.C), 0.0, period_s)
    return delay(model.delay_cycles + extra_delay, period_s).then(dynamics)


def stage_loop(gains: OuterGains, plant: System, sample_cycles: int = 1) -> System:
    """Loop transfer for negative feedback, every `sample_cycles` cycles; `plant` must not feed through."""
    if plant.D != 0.0:
        raise ValueError("the plant must not feed through: its output can't depend on the set-point of the same cycle")
    n, m = len(plant.A), len(gains.A)
    cycle = np.zeros((n + m, n + m))
    cycle[:n, :n], cycle[:n, n:] = plant.A, -np.outer(plant.B, gains.feedback)
    cycle[n:, n:] = gains.A - np.outer(gains.B, gains.feedback)
    corrected = np.eye(n + m)
    corrected[n:, n:] -= np.outer(gains.observer, gains.C)
    entering = np.concatenate([np.zeros(n), gains.observer])
    between = np.linalg.matrix_power(cycle, sample_cycles)
    output = np.concatenate([plant.C, np.zeros(m)])
    return System(between @ corrected, between @ entering, -output, 0.0, sample_cycles * plant.period_s)
