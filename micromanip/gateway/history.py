"""The past that the scope can show: the last minute row by row, the last hour as least and greatest of short blocks.

Memory is fixed. A window is asked for by cycles and by how many points across it is to be shown; what comes back is the
least and greatest value of each point, so no peak is lost, however far one zooms out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.telemetry import ROW

from .fields import Field
from .levels import Blocks, Cycles, Level, Rows, Values

FULL_ROWS = 600 * 1024
"""61 s at 10 kHz; an even multiple of every block."""
BLOCKS = ((16, FULL_ROWS // 16), (256, 141_312))
"""Rows in a block and how many blocks are kept, of each level; the last one is an hour at 10 kHz."""


@dataclass(frozen=True)
class Window:
    """Some columns over some cycles: `cycles` (n) is where each point begins, `low` and `high` are (columns, n).

    `rows` is how many rows a point stands for at most: with 1 the values are whole, and `low` is `high`. `missing` is
    how many cycles between the first and the last have no row: the loop skipped them, or they were lost on the way.
    """

    cycles: Cycles
    low: Values
    high: Values
    rows: int
    missing: int


class Past:
    """Some `fields`, as whole rows and as blocks of them; the number of rows in a block rises."""

    def __init__(self, fields: Sequence[Field], rows: Level, blocks: Sequence[Blocks]) -> None:
        self.fields = list(fields)
        self._index = {field.name: i for i, field in enumerate(fields)}
        self._rows, self._blocks = rows, list(blocks)

    @property
    def count(self) -> int:
        """Rows that have been added so far."""
        return self._rows.count

    @property
    def newest(self) -> int:
        """The newest cycle; -1 before the first."""
        return self._rows.cycle(self._rows.count - 1) if self._rows.count else -1

    @property
    def oldest(self) -> int:
        """The oldest cycle of which something is known."""
        return min((level.cycle(level.oldest) for level in (self._rows, *self._blocks) if level.count), default=0)

    @property
    def oldest_full(self) -> int:
        """The oldest cycle that is there as a row."""
        return self._rows.cycle(self._rows.oldest) if self._rows.count else 0

    def index(self, names: Sequence[str]) -> list[int]:
        """Columns of these fields; KeyError where one is unknown."""
        return [self._index[name] for name in names]

    def whole(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, Values]:
        """Values from cycle `first` to `last`, both included, as far as they are still there: (n) and (columns, n)."""
        cycles, low, _ = self._rows.taken(columns, self._rows.find(first), self._rows.find(last + 1))
        return cycles, low

    def window(self, columns: Sequence[int], first: int, last: int, points: int) -> Window:
        """From cycle `first` to `last` in at most about `points` points.

        Points are at fixed places, so that a trace that moves on does not shimmer.
        """
        level = self._level(first, last, points)
        start, stop = max(level.oldest, level.find(first + 1) - 1), level.find(last + 1)
        if level.per == 1:
            start = level.find(first)
        per = max(1, -(-(stop - start) // max(1, points)))
        start = max(level.oldest, start - start % per)
        cycles, low, high = level.taken(columns, start, stop)
        known = len(cycles) * level.per
        missing = int(cycles[-1] - cycles[0]) + level.per - known if len(cycles) else 0
        if per > 1 and len(cycles):
            begins = np.unique(np.r_[0, np.arange(per - start % per, len(cycles), per)])
            cycles = cycles[begins]
            low, high = np.fmin.reduceat(low, begins, axis=1), np.fmax.reduceat(high, begins, axis=1)
        return Window(cycles, low, high, per * level.per, max(0, missing))

    def _level(self, first: int, last: int, points: int) -> Level:
        """The coarsest level that has two blocks a point, of those that reach back to `first`; else who does best."""
        fit: Level = self._rows
        wanted = (last - first + 1) / max(1, points) / 2
        for level in self._blocks:
            if level.per <= wanted or not _reaches(fit, first):
                fit = level if _is_older(level, fit) or level.per <= wanted else fit
        return fit


class History(Past):
    """The past of a running cell; its memory is fixed."""

    def __init__(
        self, fields: Sequence[Field], full_rows: int = FULL_ROWS, blocks: Sequence[tuple[int, int]] = BLOCKS
    ) -> None:
        """`full_rows` is an even multiple of each number of rows in `blocks`."""
        self._ring = Rows(fields, ROW, full_rows)
        super().__init__(fields, self._ring, [Blocks(len(fields), *block) for block in blocks])
        self._levels: list[Rows | Blocks] = [self._ring, *self._blocks]

    @property
    def nbytes(self) -> int:
        """Memory that it takes at most."""
        return sum(level.nbytes for level in self._levels)

    def take(self) -> None:
        """Have the memory now, so that it is not found missing an hour later."""
        for level in self._levels:
            level.take()

    def clear(self) -> None:
        """Forget everything, and keep the memory."""
        for level in self._levels:
            level.count = 0

    def add(self, rows: NDArray[Any]) -> None:
        """Rows of the ring, oldest first, at most as many as there are kept."""
        half = self._ring.capacity // 2  # so that what is in no whole block yet is not overwritten
        for begin in range(0, len(rows), half):
            self._ring.add(rows[begin : begin + half])
            for level in self._blocks:
                self._fill(level)

    def _fill(self, level: Blocks) -> None:
        """The blocks that have become whole."""
        rows = self._ring
        first, last = level.count, rows.count // level.per
        if last == first:
            return
        cycles, values, _ = rows.taken(range(len(self.fields)), first * level.per, last * level.per)
        parts = values.reshape(len(self.fields), -1, level.per)
        level.add(cycles[:: level.per], np.fmin.reduce(parts, axis=2), np.fmax.reduce(parts, axis=2))

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Rows (n) from cycle `first` to `last`, both included, as the loop wrote them, as far as they are there."""
        return self._ring.whole(self._ring.find(first), self._ring.find(last + 1))


def _reaches(level: Level, first: int) -> bool:
    return level.count > 0 and (level.oldest == 0 or level.cycle(level.oldest) <= first)


def _is_older(level: Level, than: Level) -> bool:
    if not level.count:
        return False
    return level.cycle(level.oldest) < than.cycle(than.oldest)
