"""Identical parts one after the other on a simulated cell that learns from each: what is left of what repeats.

Beside each part the same is made without noise: that shows what repeats of its error. The rest of the part's error,
noise and process, is the floor, which no learning lowers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from micromanip.settings.check import Prepared

from .law import Update
from .parts import Cell


@dataclass(frozen=True)
class Made:
    """One axis in one part: true path error, what of it repeats and what does not, um rms; what became of it."""

    whole_um: float
    repeats_um: float
    floor_um: float
    verdict: str
    learned_Hz: tuple[tuple[float, float], ...]
    contraction: float

    @property
    def over_floor(self) -> float:
        """Whole over floor."""
        return self.whole_um / self.floor_um


@dataclass(frozen=True)
class AxisTrial:
    """All parts of an axis; `uncompensated_um` is the path error without any control, rms."""

    axis: str
    uncompensated_um: float
    parts: tuple[Made, ...]

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        parts = [{**asdict(each), "over_floor": each.over_floor} for each in self.parts]
        return {"axis": self.axis, "uncompensated_um": self.uncompensated_um, "parts": parts}


def trial(
    prepared: Prepared, parts: int, seconds: float, seed: int, limit_um: float, say: Callable[[str], None]
) -> tuple[AxisTrial, ...]:
    """`parts` parts with noise of seeds from `seed` on, each played with what was learned from those before.

    Raises CheckFailed where the cell can't learn or fails, UsageError where it is not simulated.
    """
    cell = Cell(prepared, seconds, limit_um)
    made: dict[str, list[Made]] = {name: [] for name in cell.ways}
    uncompensated: dict[str, float] = {}
    for k in range(parts):
        say(f"part {k + 1} of {parts}")
        played = cell.corrections
        rows, begin_s = cell.make(seed + k, played)
        errors, repeating = cell.true_error(rows, begin_s), cell.true_error(*cell.make(None, played))
        moved = cell.true_error(rows, begin_s, "uncompensated_um")
        uncompensated = {name: _rms(each) for name, each in moved.items()}
        for name, found in cell.learn(rows, begin_s, f"part {k + 1}").items():
            made[name].append(_made(errors[name], repeating[name], found))
    return tuple(AxisTrial(name, uncompensated[name], tuple(each)) for name, each in made.items())


def _made(error_um: Any, repeating_um: Any, found: Update) -> Made:
    now = found.memory.now
    floor_um = _rms(error_um - repeating_um)
    return Made(_rms(error_um), _rms(repeating_um), floor_um, found.verdict, now.learned_Hz, now.contraction)


def _rms(x: Any) -> float:
    return float(np.sqrt(np.mean(x**2)))
