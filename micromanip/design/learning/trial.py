"""Identical parts one after the other on a simulated cell, learning from each, and what is left of what repeats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from micromanip.settings.check import Prepared

from .parts import Cell, Left

_CHECKS = 1_000_000
"""Added to the seed: what is checked with is other noise than what was learned from."""


@dataclass(frozen=True)
class AxisTrial:
    """An axis: path error of each part, um rms, and what is left without a correction and with the last part's."""

    axis: str
    uncompensated_um: float
    parts_um: tuple[float, ...]
    verdicts: tuple[str, ...]
    learned_Hz: tuple[tuple[float, float], ...]
    first: Left
    last: Left


@dataclass(frozen=True)
class Trial:
    """All axes."""

    axes: tuple[AxisTrial, ...]

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"axes": [asdict(axis) for axis in self.axes]}


def trial(
    prepared: Prepared, parts: int, seconds: float, checks: int, seed: int, limit_um: float, say: Callable[[str], None]
) -> Trial:
    """`parts` parts with noise of seeds from `seed` on, and twice `checks` parts to tell what is left.

    Raises CheckFailed where the cell can't learn or fails, UsageError where it is not simulated.
    """
    cell = Cell(prepared, seconds, limit_um)
    count = parts + 2 * checks
    errors: dict[str, list[float]] = {name: [] for name in cell.ways}
    verdicts: dict[str, list[str]] = {name: [] for name in cell.ways}
    uncompensated: dict[str, float] = {}
    played, learned = {}, {}
    for k in range(parts):
        say(f"part {k + 1} of {count}")
        played = {name: memory.now.correction_um for name, memory in cell.memories.items()}
        learned = {name: memory.now.learned_Hz for name, memory in cell.memories.items()}
        rows, begin_s = cell.make(seed + k)
        for name, error in cell.true_error(rows, begin_s).items():
            errors[name].append(_rms(error))
        uncompensated = {name: _rms(each) for name, each in cell.true_error(rows, begin_s, "uncompensated_um").items()}
        for name, found in cell.learn(rows, begin_s, f"part {k + 1}").items():
            verdicts[name].append(found.verdict)
    seeds = range(seed + _CHECKS, seed + _CHECKS + checks)
    first = cell.left(seeds, {}, _counting(say, parts, count))
    last = cell.left(seeds, played, _counting(say, parts + checks, count))
    return Trial(
        tuple(
            AxisTrial(
                name, uncompensated[name], tuple(errors[name]), tuple(verdicts[name]), learned[name], first[name],
                last[name],
            )
            for name in cell.ways
        )
    )  # fmt: skip


def _counting(say: Callable[[str], None], done: int, count: int) -> Callable[[int], None]:
    return lambda place: say(f"part {done + place + 1} of {count}")


def _rms(x: Any) -> float:
    return float(np.sqrt(np.mean(x**2)))
