"""Frequency responses of one axis in closed loop: what the path error is of each thing that comes in.

The outer loop as it runs (``rt/laws/estimator.py``, ``rt/laws/lqg.py``), with the estimate x after a sample of every
cycle:

    x = (I - L C) x- + L (y + n),   u = r - K x,   x-+ = A x + B u

is u = R(z) r - Y(z) (y + n). Around a plant G from set-point to stage, with what disturbs the stage, v, it gives

    y = (G R r + v - G Y n) / (1 + G Y).

Inside, the strain loop takes the set-point through feedforward F (V/um) and PID C to the voltage. Whatever the
actuator is, the gauge's noise m acts as a set-point of ``-C / (F + C) m``, a voltage w as one of ``1 / (F + C) w``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.simulated_axis import LinearPlant
from micromanip.control.outer_gains import OuterGains, outer_gains
from micromanip.control.pid import pid_response
from micromanip.control.stage_loop import model_system
from micromanip.control.system import System
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.reference import AxisTracker

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SWING_UM = 5.0
"""Swing of the actuator for which the slope of its inverse is taken: between noise and path."""
_SETTLED_HZ = 1.0
"""Where the slope of the inverse is that of the actuator: creep that is slower was not in its identification."""


@dataclass(frozen=True)
class Loop:
    """The closed loop of an axis at the angular frequencies `omega` (n,), rad/s, around `plant` (n,), um per um."""

    omega: Array
    plant: Complex
    following: Complex
    """R."""
    feedback: Complex
    """Y."""
    per_voltage: Complex
    """``1 / (F + C)``, um of set-point per V."""
    per_strain: Complex
    """``-C / (F + C)``."""

    @cached_property
    def sensitivity(self) -> Complex:
        """What is left of a disturbance of the stage: ``1 / (1 + G Y)``."""
        return np.asarray(1.0 / (1.0 + self.plant * self.feedback))

    @property
    def followed(self) -> Complex:
        """From r to the stage."""
        return np.asarray(self.plant * self.following * self.sensitivity)

    @property
    def of_stage_noise(self) -> Complex:
        """From the capacitive sensor's noise to the stage."""
        return np.asarray(-self.plant * self.feedback * self.sensitivity)

    @property
    def of_setpoint(self) -> Complex:
        """From what is added to the actuator's set-point to the stage."""
        return np.asarray(self.plant * self.sensitivity)


@dataclass(frozen=True)
class AxisLaws:
    """The laws of one axis, `period_s` a cycle, as systems; raises CheckFailed for an axis that has not all of them."""

    name: str
    axis: Axis
    tracker: AxisTracker
    period_s: float

    def __post_init__(self) -> None:
        if self.axis.outer is None or self.axis.mode != "stage":
            raise CheckFailed(
                f"axis {self.name}: a budget needs the model of its stage (outer.model, mode: stage): "
                "`micromanip commission` finds it"
            )
        if self.axis.outer.sample_cycles != 1:
            raise CheckFailed(
                f"axis {self.name}: its stage is measured every {self.axis.outer.sample_cycles} cycles; a budget is "
                "made of cells whose sensors are read in every cycle"
            )

    @cached_property
    def gains(self) -> OuterGains:
        """The outer loop's."""
        assert self.axis.outer is not None
        return outer_gains(self.axis.outer, self.tracker, self.period_s)

    @cached_property
    def slope_V_per_um(self) -> float:
        """F: slope of the inverse about the working point, 0 where there is none."""
        model = self.axis.hysteresis
        if not isinstance(model, PrandtlIshlinskii) or self.axis.inner.mode == "pid":
            return 0.0
        return float(abs(harmonics(inverse_operator(model), _SWING_UM, self.axis.centre_um).gain))

    def model(self, omega: Array) -> Complex:
        """The configuration's own plant."""
        assert self.axis.outer is not None
        return model_system(self.axis.outer.model, self.period_s).response(omega)

    def around(self, plant: Complex, omega: Array) -> Loop:
        """The loop closed around `plant` (n,)."""
        gains, n = self.gains, len(self.gains.A)
        corrected = np.eye(n) - np.outer(gains.observer, gains.C)
        cycle = gains.A - np.outer(gains.B, gains.feedback)
        held = -gains.feedback @ corrected
        given = System(cycle @ corrected, gains.B, held, 1.0, self.period_s)
        seen = System(
            cycle @ corrected, cycle @ gains.observer, held, -float(gains.feedback @ gains.observer), self.period_s
        )
        pid = self._pid(omega)
        return Loop(
            omega,
            plant,
            given.response(omega),
            -seen.response(omega),
            1.0 / (self.slope_V_per_um + pid),
            -pid / (self.slope_V_per_um + pid),
        )

    def _pid(self, omega: Array) -> Complex:
        if self.axis.inner.mode == "feedforward":
            return np.zeros(len(omega), complex)
        return pid_response(self.axis.inner, self.period_s, omega)

    def simulated(self, plant: LinearPlant, omega: Array) -> tuple[Complex, Complex]:
        """Set-point to stage, and force to stage (um/N), of a simulation's `plant` with the strain loop closed.

        Its slope (um/V) is that which the inverse is right for.
        """

        def way(driven: Array, seen: Array, at: Array) -> Complex:
            return System(plant.A, driven, seen, 0.0, self.period_s).response(at)

        settled = np.array([2.0 * np.pi * _SETTLED_HZ])
        unit = float(abs(way(plant.voltage, plant.strain, settled)[0]))
        scale = 1.0 / (unit * self.slope_V_per_um) if self.slope_V_per_um else 1.0
        late = np.exp(-1j * omega * self.period_s * (1 + plant.late_cycles))
        to_strain, to_stage = (scale * late * way(plant.voltage, seen, omega) for seen in (plant.strain, plant.stage))
        pid = self._pid(omega)
        back = pid / (1.0 + to_strain * pid)
        force = way(plant.force, plant.stage, omega) - to_stage * back * way(plant.force, plant.strain, omega)
        return to_stage * (self.slope_V_per_um + pid) / (1.0 + to_strain * pid), force
