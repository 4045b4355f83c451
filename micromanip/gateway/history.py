"""The past that the scope can show: the last minute row by row, the last hour as least and greatest of short blocks.

Memory is fixed. A window is asked for by cycles and by how many points across it is to be shown; what comes back is the
least and greatest value of each point, so no peak is lost, however far one zooms out.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fields import Field

Values = NDArray[np.float32]

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

    cycles: NDArray[np.int64]
    low: Values
    high: Values
    rows: int
    missing: int


class _Level:
    """Least and greatest value of blocks of `per` rows, of the newest `capacity` blocks."""

    def __init__(self, columns: int, per: int, capacity: int) -> None:
        self.per, self.capacity, self.count = per, capacity, 0
        self.cycles = np.zeros(capacity, np.int64)
        self.low = np.zeros((columns, capacity), np.float32)
        self.high = self.low if per == 1 else np.zeros((columns, capacity), np.float32)

    @property
    def oldest(self) -> int:
        """Number of the oldest block that is still there."""
        return max(0, self.count - self.capacity)

    def find(self, cycle: int) -> int:
        """Number of the first block that begins at `cycle` or later."""
        return bisect.bisect_left(
            range(self.count), cycle, lo=self.oldest, key=lambda k: int(self.cycles[k % self.capacity])
        )

    def pieces(self, start: int, stop: int) -> list[slice]:
        """Where the blocks from `start` to before `stop` are: one or two slices."""
        begin, count = start % self.capacity, stop - start
        if begin + count <= self.capacity:
            return [slice(begin, begin + count)]
        return [slice(begin, self.capacity), slice(0, begin + count - self.capacity)]

    def add(self, cycles: NDArray[np.int64], low: Values, high: Values) -> None:
        """Blocks (n), (columns, n) at the end."""
        done = 0
        for piece in self.pieces(self.count, self.count + len(cycles)):
            part = slice(done, done + piece.stop - piece.start)
            self.cycles[piece] = cycles[part]
            self.low[:, piece] = low[:, part]
            if self.high is not self.low:
                self.high[:, piece] = high[:, part]
            done = part.stop
        self.count += len(cycles)


class History:
    """Of these `fields`."""

    def __init__(
        self, fields: Sequence[Field], full_rows: int = FULL_ROWS, blocks: Sequence[tuple[int, int]] = BLOCKS
    ) -> None:
        """`full_rows` is an even multiple of each number of rows in `blocks`, which rise."""
        self.fields = list(fields)
        self._index = {field.name: i for i, field in enumerate(fields)}
        self._levels = [_Level(len(fields), 1, full_rows), *(_Level(len(fields), *block) for block in blocks)]

    @property
    def count(self) -> int:
        """Rows that have been added so far."""
        return self._levels[0].count

    @property
    def newest(self) -> int:
        """The newest cycle; -1 before the first."""
        rows = self._levels[0]
        return int(rows.cycles[(rows.count - 1) % rows.capacity]) if rows.count else -1

    @property
    def oldest(self) -> int:
        """The oldest cycle of which something is known."""
        return min((int(e.cycles[e.oldest % e.capacity]) for e in self._levels if e.count), default=0)

    @property
    def oldest_full(self) -> int:
        """The oldest cycle that is there as a row."""
        rows = self._levels[0]
        return int(rows.cycles[rows.oldest % rows.capacity]) if rows.count else 0

    def index(self, names: Sequence[str]) -> list[int]:
        """Columns of these fields; KeyError where one is unknown."""
        return [self._index[name] for name in names]

    def add(self, rows: NDArray[Any]) -> None:
        """Rows of the ring, oldest first, at most as many as there are kept."""
        half = self._levels[0].capacity // 2  # so that what is in no whole block yet is not overwritten
        for begin in range(0, len(rows), half):
            self._add(rows[begin : begin + half])

    def _add(self, rows: NDArray[Any]) -> None:
        values = np.empty((len(self.fields), len(rows)), np.float32)
        for i, field in enumerate(self.fields):
            values[i] = field.of(rows)
        self._levels[0].add(rows["cycle"], values, values)
        for level in self._levels[1:]:
            self._fill(level)

    def _fill(self, level: _Level) -> None:
        """The blocks that have become whole."""
        rows = self._levels[0]
        first, last = level.count, rows.count // level.per
        if last == first:
            return
        for piece in rows.pieces(first * level.per, last * level.per):
            part = rows.low[:, piece].reshape(len(self.fields), -1, level.per)
            level.add(rows.cycles[piece][:: level.per], np.fmin.reduce(part, axis=2), np.fmax.reduce(part, axis=2))

    def whole(self, columns: Sequence[int], first: int, last: int) -> tuple[NDArray[np.int64], Values]:
        """Rows from cycle `first` to `last`, both included, as far as they are still there: (n) and (columns, n)."""
        rows = self._levels[0]
        cycles, low, _ = _taken(rows, columns, rows.find(first), rows.find(last + 1))
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
        cycles, low, high = _taken(level, columns, start, stop)
        known = len(cycles) * level.per
        missing = int(cycles[-1] - cycles[0]) + level.per - known if len(cycles) else 0
        if per > 1 and len(cycles):
            begins = np.unique(np.r_[0, np.arange(per - start % per, len(cycles), per)])
            cycles = cycles[begins]
            low, high = np.fmin.reduceat(low, begins, axis=1), np.fmax.reduceat(high, begins, axis=1)
        return Window(cycles, low, high, per * level.per, max(0, missing))

    def _level(self, first: int, last: int, points: int) -> _Level:
        """The coarsest level that has two blocks a point, of those that reach back to `first`; else who does best."""
        fit = self._levels[0]
        wanted = (last - first + 1) / max(1, points) / 2
        for level in self._levels[1:]:
            if level.per <= wanted or not self._reaches(fit, first):
                fit = level if self._is_older(level, fit) or level.per <= wanted else fit
        return fit

    @staticmethod
    def _reaches(level: _Level, first: int) -> bool:
        return level.count > 0 and (level.oldest == 0 or int(level.cycles[level.oldest % level.capacity]) <= first)

    @staticmethod
    def _is_older(level: _Level, than: _Level) -> bool:
        if not level.count:
            return False
        return int(level.cycles[level.oldest % level.capacity]) < int(than.cycles[than.oldest % than.capacity])


def _taken(level: _Level, columns: Sequence[int], start: int, stop: int) -> tuple[NDArray[np.int64], Values, Values]:
    pieces = level.pieces(start, max(start, stop))
    cycles = np.concatenate([level.cycles[piece] for piece in pieces])
    low = np.concatenate([level.low[columns, piece] for piece in pieces], axis=1)
    if level.high is level.low:
        return cycles, low, low
    return cycles, low, np.concatenate([level.high[columns, piece] for piece in pieces], axis=1)
