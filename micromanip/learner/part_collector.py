"""The rows of a part, out of the telemetry of a running cell: with some before it, as soon as it is whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.design.learning.part import BEYOND_S, SETTLED_S
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

    Its `rows` (n,) of KEPT track, to `BEYOND_S` after the part.
    """

    number: int
    begun: int
    tool: int
    rows: NDArray[Any]


@dataclass(frozen=True)
class _Open:
    number: int
    begun: int
    tool: int


class PartCollector:
    """Takes rows as they come, gives parts."""

    def __init__(self, seconds: float, period_s: float) -> None:
        """A part takes `seconds`."""
        self._cycles, self._period_s = round(seconds / period_s), period_s
        self._before, self._beyond = 2 * round(SETTLED_S / period_s), round(BEYOND_S / period_s)
        self._rows: list[NDArray[Any]] = []
        self._last: tuple[bool, bool, bool, int] | None = None
        self._open: list[_Open] = []
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
            yield from self._whole(int(cycles[k]))
            why = "tracking ended" if lost[k] else "the tool was changed" if others[k] and not began[k] else "it ended"
            yield from self._unfinished(int(cycles[k]), self._cycles + (self._beyond if lost[k] else 0), why)
            if lost[k]:
                self._rows.clear()
            elif began[k] and tracks[k]:
                self.parts += 1
                self._open.append(_Open(self.parts, int(cycles[k]), int(tools[k])))
        self._rows.append(kept[done:][tracks[done:]])
        self._last = bool(tracks[-1]), bool(runs[-1]), bool(turn[-1]), int(tools[-1])
        yield from self._whole(int(cycles[-1]) + 1)
        self.tool = int(tools[-1])
        self._let_go(int(cycles[-1]))

    def drop(self) -> None:
        """What is being made is not learned from."""
        self._open.clear()

    def _whole(self, cycle: int) -> Iterator[MadePart]:
        """Parts of which all rows before `cycle` are enough."""
        for part in [part for part in self._open if part.begun + self._cycles + self._beyond <= cycle]:
            self._open.remove(part)
            rows = np.concatenate(self._rows)
            last = part.begun + self._cycles + self._beyond
            wanted = (rows["cycle"] >= part.begun - self._before) & (rows["cycle"] < last)
            yield MadePart(part.number, part.begun, part.tool, rows[wanted])

    def _unfinished(self, cycle: int, least: int, why: str) -> Iterator[str]:
        """Parts that end in `cycle`, before they have lasted `least` cycles."""
        for part in [part for part in self._open if cycle - part.begun < least]:
            self._open.remove(part)
            lasted_s = (cycle - part.begun) * self._period_s
            yield f"part {part.number} was not finished, {why} after {lasted_s:.2f} s: nothing is learned from it"

    def _let_go(self, newest: int) -> None:
        oldest = min([part.begun for part in self._open] or [newest]) - self._before
        while self._rows and (not len(self._rows[0]) or self._rows[0]["cycle"][-1] < oldest):
            self._rows.pop(0)


def _kept(rows: NDArray[Any]) -> NDArray[Any]:
    found = np.zeros(len(rows), KEPT)
    for name in _CELL:
        found[name] = rows[name]
    for name in _AXIS:
        found["axis"][name] = rows["axis"][name]
    return found
