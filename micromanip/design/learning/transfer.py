"""From a correction of the reference to the stage: the laws as they run around the model, and around other plants.

The correction c comes with its first and second difference, of which the outer loop takes ``G_0 + G_1 s + G_2 s^2``
(`control/outer_gains.py`), so that with R, Y and the plant G of `budget/loop.py`

    T = G R / (1 + G Y) (G_0 + j G_1 sin(w h) / h - 2 G_2 (1 - cos(w h)) / h^2).

It is 1 where the loop follows. How wrong it may be is ``off = max |1 - T_D / T|`` over plants D drawn as robustness is
judged for (`loops/perturbation.py::SPREAD`): mass, stiffness, damping and delay of the stage.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import System
from micromanip.design.analyse.budget.loop import AxisLaws
from micromanip.design.analyse.loops import draw
from micromanip.design.analyse.loops.monte_carlo import drawn_plant
from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

DRAWS = 40
MOST_OFF = 0.2
"""Up to where the transfer is this well known at least, something is learned."""
_GRID_HZ = np.concatenate([np.array([0.05, 0.2, 0.5]), np.arange(1.0, 201.0)])


@dataclass(frozen=True)
class Transfer:
    """Correction to stage, um per um, of the axis with `laws`."""

    laws: AxisLaws
    draws: int = DRAWS

    def response(self, hertz: Array) -> Complex:
        """T (n,) with the configured model."""
        omega = np.asarray(2.0 * np.pi * hertz)
        return self._around(self.laws.model(omega), omega)

    def off(self, hertz: Array) -> Array:
        """How far T may be off (n,), by linear interpolation; what is beyond 200 Hz is not known."""
        return np.asarray(np.interp(hertz, _GRID_HZ, self._off, right=np.inf))

    @cached_property
    def highest_Hz(self) -> float:
        """Up to where T is known to `MOST_OFF`; 0 where it is nowhere."""
        wrong = np.flatnonzero(self._off > MOST_OFF)
        return float(_GRID_HZ[-1] if not len(wrong) else _GRID_HZ[wrong[0] - 1] if wrong[0] else 0.0)

    @cached_property
    def _off(self) -> Array:
        omega = 2.0 * np.pi * _GRID_HZ
        nominal = self._around(self.laws.model(omega), omega)
        return np.asarray(
            np.max(
                [abs(1.0 - self._around(plant.response(omega), omega) / nominal) for plant in self._plants()], axis=0
            )
        )

    def _plants(self) -> list[System]:
        outer = self.laws.axis.outer
        assert outer is not None
        drawn = [drawn_plant(draw(seed), None, outer.model, self.laws.period_s) for seed in range(self.draws)]
        return [plant for plant in drawn if plant is not None]

    def _around(self, plant: Complex, omega: Array) -> Complex:
        h, row = self.laws.period_s, self.laws.gains.reference
        taken = row[0] + 1j * row[1] * np.sin(omega * h) / h - 2.0 * row[2] * (1.0 - np.cos(omega * h)) / h**2
        return np.asarray(self.laws.around(plant, omega).followed * taken)


def way_of(configuration: Configuration, name: str) -> Transfer:
    """From a correction to the stage of axis `name`. CheckFailed where its laws don't allow of one."""
    tracker, axis = configuration.reference, configuration.axes[name]
    if not isinstance(tracker, Tracker):
        raise CheckFailed(
            f"only what follows a tracker learns: reference.source is {tracker.source}, it must be signal"
        )
    if axis.authority_percent != 100.0:
        raise CheckFailed(f"axis {name}: authority_percent is {axis.authority_percent:g}: it learns with 100 only")
    return Transfer(AxisLaws(name, axis, tracker.of(name), configuration.loop.period_ns * 1e-9))
