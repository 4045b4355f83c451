"""A move of a held axis: waypoints one after the other, a sine, or a sweep of its frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.laws.move import MOVE_PARAMETERS, OSCILLATION, PLACES, course

Array = NDArray[np.float64]

PEAK = 1.875
"""Greatest speed of minimum jerk, as a multiple of the mean."""
_POINTS, _A_TURN, _TURNS = 600, 24, 6
"""Looked at: places of a course of ways, or of a turn, and how many turns."""


@dataclass(frozen=True)
class Move:
    """`places` are (um from where it begins, way, rest) with times in cycles; an oscillation has none.

    Frequencies, first and last, in turns per cycle; `fastest` is the greatest change within a cycle (um).
    """

    places: tuple[tuple[float, int, int], ...]
    cycles: int
    stop_cycles: int
    amplitude_um: float = 0.0
    fade_cycles: int = 1
    first: float = 0.0
    last: float = 0.0

    @property
    def fastest(self) -> float:
        """Greatest change within a cycle, um."""
        if not self.places:
            fading = PEAK / self.fade_cycles
            return self.amplitude_um * (2.0 * math.pi * max(self.first, self.last) + fading)
        before = [0.0, *(um for um, _, _ in self.places)]
        return max(
            PEAK * abs(um - last) / way for last, (um, way, _) in zip(before, self.places, strict=False) if way > 0
        )

    def fill(self, record: Any, number: int, *, stop: bool = False) -> None:
        """Write it into the loop's record MOVE_PARAMETERS."""
        record["number"], record["stop"], record["stop_cycles"] = number, int(stop), self.stop_cycles
        record["kind"], record["cycles"] = PLACES if self.places else OSCILLATION, self.cycles
        record["fade_cycles"], record["amplitude_um"] = self.fade_cycles, self.amplitude_um
        record["first_per_cycle"], record["last_per_cycle"], record["places"] = self.first, self.last, len(self.places)
        for i, (um, way, rest) in enumerate(self.places):
            record["place_um"][i], record["way_cycles"][i], record["rest_cycles"][i] = um, way, rest

    def looked_at(self) -> Array:
        """Offsets (n,) in um through which it goes, in order, close enough to see where it turns.

        Of an oscillation some turns of its whole amplitude: those before are smaller, and those after are the same.
        """
        if not self.places:
            return self.amplitude_um * np.sin(2.0 * np.pi * np.arange(_TURNS * _A_TURN + 1) / _A_TURN)
        record = np.zeros(1, MOVE_PARAMETERS)[0]
        self.fill(record, 1)
        return np.array([course(record, float(k)) for k in np.linspace(0.0, self.cycles, _POINTS)])
