"""The rows of a part, out of the telemetry of a running cell: with some before it, as soon as it is whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.record import record
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import PART_RUNS, PART_TURN, ROW, TOOL

BEFORE_S, AFTER_S = 1.5, 0.2
"""Kept beside a part: for filters that see beyond the part."""

_CELL = ("cycle", "time_ns", "state", "lines")
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
    """The `number`-th part of this run, told to have begun in `begun`, with `tool` from then on.

    Its `rows` (n,) of KEPT begin tracking.
    """

    number: int
    begun: int
    rows: NDArray[Any]
    tool: int

    @property
    def first(self) -> int:
        """The first cycle of `rows`."""
        return int(self.rows["cycle"][0])


@dataclass
class _Open:
    number: int
    begun: int
    tool: int
    recognised: bool = False


class Gathering:
    """Takes rows as they come, gives parts; of a path that repeats each period is one."""

    def __init__(
        self, seconds: float, search_s: float, recognised_s: float, period_s: float, *, repeats: bool = False
    ) -> None:
        """A part takes `seconds`, and began within `search_s`; it can be recognised by `recognised_s` of it.

        One that `repeats` is followed by the next until it ends.
        """
        self._period = round(seconds / period_s) if repeats else None
        self._next: int | None = None
        self._whole = round((seconds + search_s + AFTER_S) / period_s)
        self._least = round((seconds - search_s) / period_s)
        self._seen = round((recognised_s + search_s + AFTER_S) / period_s)
        self._before = round((BEFORE_S + search_s) / period_s)
        self._period_s = period_s
        self._rows: list[NDArray[Any]] = []
        self._last: tuple[bool, bool, int] | None = None
        self._open: list[_Open] = []
        self.parts = 0
        """Begun so far."""
        self.tool = 0
        """In the last row that came."""

    def add(self, rows: NDArray[Any]) -> Iterator[str]:
        """Take rows (n,) of ROW; a sentence for each part that ends before its time."""
        if not len(rows):
            return
        kept = np.zeros(len(rows), KEPT)
        for name in _CELL:
            kept[name] = rows[name]
        for name in _AXIS:
            kept["axis"][name] = rows["axis"][name]
        self._rows.append(kept)
        runs, turn = rows["lines"] & PART_RUNS != 0, rows["lines"] & PART_TURN != 0
        tracks = rows["state"] == TRACKING
        tools = rows["lines"] >> TOOL
        was_running, was_turn, was_tool = self._last or (bool(runs[0]), bool(turn[0]), int(tools[0]))
        begins = np.diff(turn, prepend=was_turn)
        others = np.diff(tools, prepend=was_tool) != 0
        ends = begins | (np.append(was_running, runs[:-1]) & ~runs) | ~tracks | others
        self.tool = int(tools[-1])
        self._last = bool(runs[-1]), bool(turn[-1]), self.tool
        for k in np.flatnonzero(ends):
            cycle = int(rows["cycle"][k])
            self._go_on(cycle, was_tool)
            yield from self._ended(cycle, "the tool was changed" if others[k] and not begins[k] else "it ended")
            if begins[k] and tracks[k]:
                self.parts += 1
                self._open.append(_Open(self.parts, cycle, int(tools[k])))
                self._next = None if self._period is None else cycle + self._period
            was_tool = int(tools[k])
        self._go_on(int(rows["cycle"][-1]), self.tool)
        self._let_go()

    def _go_on(self, cycle: int, tool: int) -> None:
        """Open the periods that have begun before `cycle` since the last did."""
        while self._next is not None and self._period is not None and self._next < cycle:
            self.parts += 1
            self._open.append(_Open(self.parts, self._next, tool, recognised=True))
            self._next += self._period

    def move(self, cycles: int) -> None:
        """By so much later the periods begin that are being made, and those that come."""
        for part in self._open:
            part.begun += cycles
        if self._next is not None:
            self._next += cycles

    def recognisable(self) -> Iterator[MadePart]:
        """Each part once, when enough of it has been made to know it by its path."""
        for part in self._open:
            if not part.recognised and self._newest >= part.begun + self._seen:
                part.recognised = True
                yield self._made(part, self._seen)

    def whole(self) -> Iterator[MadePart]:
        """Each part once, when all of it has been made."""
        for part in [part for part in self._open if self._newest >= part.begun + self._whole]:
            self._open.remove(part)
            yield self._made(part, self._whole)

    def drop(self) -> None:
        """What is being made is not learned from."""
        self._open.clear()

    @property
    def heard(self) -> bool:
        """Whether any row has come yet."""
        return self._last is not None

    @property
    def _newest(self) -> int:
        return int(self._rows[-1]["cycle"][-1]) if self._rows else -1

    def _ended(self, cycle: int, why: str) -> Iterator[str]:
        """No part goes on beyond `cycle`: one that has not lasted long enough is not finished.

        A path that repeats ends where it does, and that is not told.
        """
        repeated, self._next = self._next is not None, None
        for part in [part for part in self._open if cycle - part.begun < self._least]:
            self._open.remove(part)
            if repeated:
                continue
            lasted_s = (cycle - part.begun) * self._period_s
            yield f"part {part.number} was not finished, {why} after {lasted_s:.2f} s: nothing is learned from it"

    def _made(self, part: _Open, cycles: int) -> MadePart:
        rows = np.concatenate(self._rows)
        wanted = (rows["cycle"] >= part.begun - self._before) & (rows["cycle"] < part.begun + cycles)
        rows = rows[wanted]
        rested = np.flatnonzero((rows["state"] != TRACKING) & (rows["cycle"] < part.begun))
        return MadePart(part.number, part.begun, rows[rested[-1] + 1 if len(rested) else 0 :], part.tool)

    def _let_go(self) -> None:
        oldest = min([part.begun for part in self._open] or [self._newest]) - self._before
        while self._rows and self._rows[0]["cycle"][-1] < oldest:
            self._rows.pop(0)
