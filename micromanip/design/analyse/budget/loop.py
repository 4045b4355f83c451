"""Frequency responses of one axis in closed loop: what the path error is of each thing that comes in.

The outer loop as it runs (``rt/laws/estimator.py``, ``rt/laws/lqg.py``), with the estimate x after a sample of every
cycle:

    x = (I - L C) x- + L (y + n),   u = r - K x,   x-+ = A x + B u

is u = R(z) r - Y(z) (y + n). Around a plant G from set-point to stage, with what disturbs the stage, v, it gives

    y = (G R r + v - G Y n) / (1 + G Y).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from micromanip.control.outer_gains import OuterGains, outer_gains
from micromanip.control.stage_loop import model_system
from micromanip.control.system import Array, Complex, System
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.reference import AxisTracker


@dataclass(frozen=True)
class Loop:
    """The closed loop of an axis at the angular frequencies `omega` (n,), rad/s, around `plant` (n,), um per um."""

    omega: Array
    plant: Complex
    following: Complex
    """R."""
    feedback: Complex
    """Y."""

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
        return Loop(omega, plant, given.response(omega), -seen.response(omega))
