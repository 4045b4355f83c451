"""How far the spindle really is from its path, as only the plant knows it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

_EVERY_NS = 1_000_000
_TRUTH = {"path_error": "", "uncompensated": "uncompensated_"}


@dataclass
class Figures:
    """Of one quantity over time."""

    samples: int = 0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, value: float) -> None:
        """One more sample."""
        self.samples += 1
        self.squares += value * value
        self.largest = max(self.largest, abs(value))

    @property
    def rms(self) -> float | None:
        """Root mean square; None without samples."""
        return math.sqrt(self.squares / self.samples) if self.samples else None


class PathError:
    """Figures of ``path_error_<axis>`` and ``uncompensated_<axis>``, a sample a millisecond."""

    def __init__(self, channels: dict[str, int]) -> None:
        """`channels` are the plant's inputs; those that it doesn't have are left out."""
        self.names = [name for name in channels if name.rsplit("_", 1)[0] in _TRUTH]
        self._figures = {name: Figures() for name in self.names}
        self._due_ns = 0

    def due(self, now_ns: int) -> bool:
        """Whether it is time for the next samples."""
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + _EVERY_NS
        return True

    def add(self, name: str, value: float) -> None:
        """A sample of one of `names`."""
        self._figures[name].add(value)

    def report(self) -> dict[str, Any]:
        """By axis: rms, max, uncompensated_rms, uncompensated_max."""
        axes: dict[str, Any] = {}
        for name, figures in self._figures.items():
            quantity, axis = name.rsplit("_", 1)
            axes.setdefault(axis, {})[f"{_TRUTH[quantity]}rms"] = figures.rms
            axes[axis][f"{_TRUTH[quantity]}max"] = figures.largest if figures.samples else None
        return axes
