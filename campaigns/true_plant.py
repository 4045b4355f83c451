"""What a plant truly does: from its own equations, never from a recording.

Only the hysteresis is not linear. It is replaced by a slope; amplifier, lag, creep, mechanics, gauge and delays are
those of the simulation, sub-step by sub-step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from micromanip.control.pid import pid_system
from micromanip.control.system import System
from micromanip.settings.schema.axis import Axis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TruePlant:
    """Voltage as it is decided (V) to gauge and to stage sensor (um), a step per cycle, both from the same states."""

    A: Array
    B: Array
    strain: Array
    stage: Array
    period_s: float

    def actuator(self) -> System:
        """Voltage to gauge."""
        return System(self.A, self.B, self.strain, 0.0, self.period_s)

    def behind(self, axis: Axis, feedforward_V_per_um: float) -> System:
        """Set-point to stage sensor, the strain loop of `axis` closed and its feedforward as steep as given."""
        pid = pid_system(axis.inner, self.period_s)
        A = np.block(
            [
                [self.A - np.outer(self.B, pid.D * self.strain), np.outer(self.B, pid.C)],
                [-np.outer(pid.B, self.strain), pid.A],
            ]
        )
        B = np.concatenate([self.B * (feedforward_V_per_um + pid.D), pid.B])
        return System(A, B, np.concatenate([self.stage, np.zeros(len(pid.A))]), 0.0, self.period_s)


def linearised(
    slope_um_per_V: float,
    follow: float,
    lag: tuple[float, float],
    creep: tuple[Array, Array],
    mechanics: tuple[Array, Array],
    rows: tuple[Array, Array],
    substeps: int,
    late: int,
    period_s: float,
) -> TruePlant:
    """A plant whose hysteresis is a slope: amplifier, lag, creep, mechanics, each fed by what is before it.

    `follow` is the share of the way that the amplifier goes in a sub-step; `lag` what share of the displacement lags,
    and its own share of the way; `creep` gains and shares of the way (n,); `mechanics` (m, m) and (m,); `rows` (m,) of
    the gauge and of the stage sensor; `late` whole periods that a voltage comes too late.
    """
    gains, creep_steps = creep
    (n,), (a, b), (lags, lag_step) = gains.shape, mechanics, lag
    size = 2 + n + len(a)
    unit = np.eye(size + 1)  # states, and the input, which stays

    def updated(first: int, keep: Array, source: Array) -> Array:
        """States from `first` on become ``keep x + source``, with `source` (k, size + 1) in terms of all."""
        change, own = unit.copy(), slice(first, first + len(keep))
        change[own] = source
        change[own, own] += keep
        return change

    whole = slope_um_per_V * unit[0]
    pure = (1.0 - lags) * whole + lags * unit[1]
    free = (1.0 - gains.sum()) * pure + unit[2 : 2 + n].sum(axis=0)
    step = updated(0, np.array([[1.0 - follow]]), follow * unit[-1:])
    step = updated(1, np.array([[1.0 - lag_step]]), lag_step * whole[None]) @ step
    step = updated(2, np.diag(1.0 - creep_steps), np.outer(gains * creep_steps, pure)) @ step
    step = updated(2 + n, a, np.outer(b, free)) @ step
    period = np.linalg.matrix_power(step, substeps)
    A = block_diag(period[:size, :size], np.eye(1 + late, k=-1))
    A[:size, -1] = period[:size, -1]
    B, outputs = np.zeros(len(A)), np.zeros((2, len(A)))
    B[size], outputs[:, 2 + n : size] = 1.0, rows
    return TruePlant(A, B, *outputs, period_s)
