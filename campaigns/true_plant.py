"""True margins of a tuning on a simulated plant: from the plant's own equations, never from a recording.

Only the hysteresis is not linear. It is replaced by the slope that it has for a small swing about the working voltage;
amplifier, creep, lag, mechanics, gauge and delays are those of the simulation, sub-step by sub-step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from micromanip_drivers.simulated import mechanics
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.options import Options, Plant
from micromanip_drivers.simulated.preisach import bouc_wen_step, everett
from micromanip_drivers.simulated.records import CONTEXT, CREEP_OPERATORS, SUBSTEPS
from numpy.typing import NDArray
from scipy.linalg import block_diag

from micromanip.control.margins import Margins, margins
from micromanip.control.outer_gains import outer_gains
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import stage_loop
from micromanip.control.system import System
from micromanip.settings.schema.axis import Axis

Array = NDArray[np.float64]
SWING_V = 1.7
"""Amplitude of the small swing: that of the noise by which actuators are identified."""


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


def small_slope(plant: Plant, centre_V: float, swing_V: float = SWING_V) -> float:
    """Free displacement per volt (um/V) of a small sine about `centre_V`, creep and lag left out."""
    record = SimulatedCell(Options(axes=("x",), plant=plant), 100_000).context().view(CONTEXT)[0]
    if plant.bouc_wen is not None:
        p, s = record["p"][0]["bouc_wen"], record["s"][0]["bouc_wen"]
        p["lag_share"], s["input_V"] = 0.0, centre_V
        turn = 2.0 * np.pi * np.arange(4000) / 1000.0
        moved = np.array([bouc_wen_step(p, s, v) for v in centre_V + swing_V * np.sin(turn)])[-1000:]
        return float(2.0 * np.mean(moved * np.sin(turn[-1000:])) / swing_V)
    r = plant.reversible_um
    loop = everett(record["p"][0]["preisach"], centre_V + swing_V, centre_V - swing_V) / (2.0 * swing_V)
    return float(loop + r[0] + 2.0 * r[1] * centre_V + 3.0 * r[2] * centre_V**2)


def true_plant(plant: Plant, slope_um_per_V: float, period_s: float) -> TruePlant:
    """The plant with its hysteresis replaced by a slope."""
    step_s = period_s / SUBSTEPS
    a, b = mechanics.discrete(plant, step_s)
    m, c = len(a), CREEP_OPERATORS
    follow = -np.expm1(-step_s * 2 * np.pi * plant.amplifier_Hz)
    creep_step = -np.expm1(-step_s / np.logspace(-3, 3, c))
    share = plant.bouc_wen.lag_share if plant.bouc_wen else 0.0
    lag_step = -np.expm1(-step_s / (1e-3 * plant.bouc_wen.lag_ms)) if plant.bouc_wen else 1.0
    # amplifier, lag, creep, mechanics; each takes what the one before has just become
    size = 2 + c + m
    amplifier, lag, creep, moving = 0, 1, slice(2, 2 + c), slice(2 + c, size)
    step, drive = np.eye(size), np.zeros(size)

    def update(rows: slice, keep: Array, source: Array, fed: float) -> None:
        """Rows x -> keep x + source; `source` in terms of states (k, size), `fed` of the input."""
        step[rows] = keep @ step[rows] + source @ np.vstack([step])
        drive[rows] = keep @ drive[rows] + source @ drive + fed

    only = np.zeros((1, size))
    update(slice(amplifier, amplifier + 1), np.array([[1.0 - follow]]), only, follow)
    whole = np.zeros((1, size))
    whole[0, amplifier] = slope_um_per_V
    update(slice(lag, lag + 1), np.array([[1.0 - lag_step]]), lag_step * whole, 0.0)
    pure = (1.0 - share) * whole
    pure[0, lag] = share
    gain = plant.creep_per_operator
    update(creep, np.diag(1.0 - creep_step), gain * creep_step[:, None] * pure, 0.0)
    free = pure * (1.0 - c * gain)
    free[0, creep] = 1.0
    update(moving, a, b[:, :1] * free, 0.0)
    period, driven = np.eye(size), np.zeros(size)
    for _ in range(SUBSTEPS):
        period, driven = step @ period, step @ driven + drive
    late = 1 + plant.late_cycles
    A = block_diag(period, np.eye(late, k=-1))
    A[:size, -1] = driven
    B = np.zeros(len(A))
    B[size] = 1.0
    first = size - m
    strain, stage = np.zeros(len(A)), np.zeros(len(A))
    strain[first + 4] = stage[first + 2] = 1.0
    if plant.second_mode is not None:
        stage[first + 5] = plant.second_mode.gain
        stage[first] = -plant.second_mode.gain * plant.lever
    return TruePlant(A, B, strain, stage, period_s)


def strain_margins(
    plant: Plant, axis: Axis, centre_V: float, slopes: Sequence[float], period_s: float
) -> list[Margins]:
    """Of the strain loop for multiples of the plant's small slope."""
    small, pid = small_slope(plant, centre_V), pid_system(axis.inner, period_s)
    return [margins(pid.then(true_plant(plant, s * small, period_s).actuator())) for s in slopes]


def outer_margins(plant: Plant, axis: Axis, centre_V: float, feedforward_V_per_um: float, period_s: float) -> Margins:
    """Of the outer loop around the closed strain loop."""
    assert axis.outer is not None
    whole = true_plant(plant, small_slope(plant, centre_V), period_s).behind(axis, feedforward_V_per_um)
    return margins(stage_loop(outer_gains(axis.outer, None, period_s), whole))
