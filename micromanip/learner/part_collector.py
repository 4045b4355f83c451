"""The rows of a part, out of the telemetry of a running cell: with some before it, as soon as it is whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.design.learning.part import SETTLED_S
from micromanip.rt.record import record
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import PART_RUNS, PART_TURN, ROW, TOOL

_CELL = ("cycle", "time_ns")
_AXIS = ("deviation_age_ns", "fresh", "voltage_V", "deviation_um", "stage_um", "learned_um")
_OF_AXIS = ROW["axis"].subdtype
assert _OF_AXIS is not None
KEPT = record(
    *((name, ROW[name]) for name in _CELL),
    ("axis", record(*((name, _OF_AXIS[0][name]) for name in _AXIS)), _OF_AXIS[1]),
)
"""What of a row learning needs: two minutes of all of it would be half a gigabyte."""


@dataclass(frozen=True)
class MadePart:
    """The `number`-th part of this run, which began in the cycle `begun`, with `tool`.

    Its `rows` (n,) of KEPT track, and end with the part.
    """

    number: int
    begun: int
    tool: int
    rows: NDArray[Any]


class PartCollector:
    """Takes rows as they come, gives parts."""

    def __init__(self, seconds: float, period_s: float) -> None:
        """A part takes `seconds`."""
        self._cycles, self._period_s = round(seconds / period_s), period_s
        self._before = 2 * round(SETTLED_S / period_s)
        self._rows: list[NDArray[Any]] = []
        self._last: tuple[bool, bool, bool, int] | None = None
        self._begun: int | None = None
        self.parts = 0
        """Begun so far."""
        self.tool = 0
        """In the last row that came."""

    def add(self, rows: NDArray[Any]) -> Iterator[MadePart | str]:
        """Take rows (n,) of ROW: each part that is whole, and a sentence for each that ends before its time."""
        if not len(rows):
            return
        runs, turn = rows["lines"] & PART_RUNS != 0, rows["lines"] & PART_TURN != 0
        tracks, tools = rows["state"] == TRACKING, rows["lines"] >> TOOL
        first = self._last or (bool(tracks[0]), bool(runs[0]), bool(turn[0]), int(tools[0]))
        began, ended = np.diff(turn, prepend=first[2]), np.diff(runs.astype(int), prepend=first[1]) < 0
        lost, others = np.diff(tracks.astype(int), prepend=first[0]) < 0, np.diff(tools, prepend=first[3]) != 0
        kept, cycles, done = _kept(rows), rows["cycle"], 0
        for k in np.flatnonzero(began | ended | lost | others):
            self._rows.append(kept[done:k][tracks[done:k]])
            done = int(k)
            yield from self._whole(int(cycles[k]) - 1)
            if self._begun is not None:
                why = "the tool was changed" if others[k] and not began[k] else "it ended"
                lasted_s = (int(cycles[k]) - self._begun) * self._period_s
                yield f"part {self.parts} was not finished, {why} after {lasted_s:.2f} s: nothing is learned from it"
            self._begun = None
            if lost[k]:
                self._rows.clear()
            elif began[k] and tracks[k]:
                self.parts += 1
                self._begun, self.tool = int(cycles[k]), int(tools[k])
        self._rows.append(kept[done:][tracks[done:]])
        self._last = bool(tracks[-1]), bool(runs[-1]), bool(turn[-1]), int(tools[-1])
        yield from self._whole(int(cycles[-1]))
        self.tool = int(tools[-1])
        self._let_go(int(cycles[-1]))

    def drop(self) -> None:
        """What is being made is not learned from."""
        self._begun = None

    def _whole(self, newest: int) -> Iterator[MadePart]:
        """The part that is being made, if the rows up to the cycle `newest` are all of it."""
        if self._begun is None or newest < self._begun + self._cycles - 1:
            return
        rows = np.concatenate(self._rows)
        wanted = (rows["cycle"] >= self._begun - self._before) & (rows["cycle"] < self._begun + self._cycles)
        yield MadePart(self.parts, self._begun, self.tool, rows[wanted])
        self._begun = None

    def _let_go(self, newest: int) -> None:
        oldest = (newest if self._begun is None else self._begun) - self._before
        while self._rows and (not len(self._rows[0]) or self._rows[0]["cycle"][-1] < oldest):
            self._rows.pop(0)


def _kept(rows: NDArray[Any]) -> NDArray[Any]:
    found = np.zeros(len(rows), KEPT)
    for name in _CELL:
        found[name] = rows[name]
    for name in _AXIS:
        found["axis"][name] = rows["axis"][name]
    return found
