"""What of its memories an axis goes by: those of the tool in the spindle, near the temperature that there is.

A memory belongs to one tool, and to the temperature at which it was learned. Each combination has a file of its own;
what does not fit now is kept, and taken up again once it does. Of several the nearest temperature counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from micromanip.design.learning.memory import Memory, memory_file

UNKNOWN = -1
"""In the place of a tool's number: the signal ``tool`` names none."""


@dataclass(frozen=True)
class Conditions:
    """Number of the tool (0: nobody tells it), and degC of the cell, None where nobody measures it.

    `unmeasured`: somebody should, and no usable value came.
    """

    tool: int = 0
    temperature_C: float | None = None
    unmeasured: bool = False

    @property
    def unknown(self) -> str | None:
        """Why nothing can be said of them; None where it can."""
        if self.tool == UNKNOWN:
            return "the signal tool names no tool"
        return "the signal temperature has no usable value" if self.unmeasured else None

    def __str__(self) -> str:
        """For people."""
        if self.unknown:
            return self.unknown
        warm = "" if self.temperature_C is None else f"{self.temperature_C:.1f} degC"
        return ", ".join(filter(None, (f"tool {self.tool}" if self.tool else "", warm))) or "no tool was told"


class Shelf:
    """The memories of one axis, by their files."""

    def __init__(self, folder: Path, axis: str, within_K: float) -> None:
        """Empty; `within_K` is how far from its own temperature a memory may be used."""
        self._folder, self._axis, self._within_K = folder, axis, within_K
        self._kept: dict[Path, Memory] = {}
        self._last: Path | None = None

    def put(self, file: Path, memory: Memory) -> None:
        """Keep what is in `file`."""
        self._kept[file] = memory

    def clear(self) -> None:
        """Keep none."""
        self._last = None
        self._kept.clear()

    def fitting(self, now: Conditions) -> tuple[Path, Memory | None]:
        """The memory to go by in the conditions `now`, and its file; None, and where a new one goes.

        It stays with the one that it went by as long as that fits: between two of them it does not change at each tenth
        of a kelvin. A new one never takes the place of another, which may have followed a drift.
        """
        near = [(apart_K, file) for file in self._kept if (apart_K := self._apart_K(file, now)) <= self._within_K]
        if near and not now.unknown:
            file = next((each for _, each in near if each == self._last), min(near)[1])
            self._last = file
            return file, self._kept[file]
        warm_C = now.temperature_C
        file = memory_file(self._folder, self._axis, max(0, now.tool), warm_C)
        while file in self._kept and warm_C is not None:
            warm_C += 0.1
            file = memory_file(self._folder, self._axis, max(0, now.tool), warm_C)
        return file, None

    def _apart_K(self, file: Path, now: Conditions) -> float:
        """How far `now` is from the conditions of the memory; infinite where it is of another tool."""
        memory = self._kept[file]
        if memory.tool != now.tool or (memory.temperature_C is None) != (now.temperature_C is None):
            return math.inf
        return abs((memory.temperature_C or 0.0) - (now.temperature_C or 0.0))
