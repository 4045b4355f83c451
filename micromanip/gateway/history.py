"""The past that the scope shows: the last minute row by row, the last hour as least and greatest of short blocks.

Memory is fixed. The scope asks for a window of cycles and for a number of points across it. It gets the least and
greatest value of each point, so no peak is lost, however far one zooms out.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.telemetry import ROW

from .fields import Field

Values = NDArray[np.float32]
Cycles = NDArray[np.int64]

FULL_ROWS = 600 * 1024
"""61 s at 10 kHz; an even multiple of every block."""
BLOCKS = ((16, FULL_ROWS // 16), (256, 141_312))
"""Rows in a block and number of blocks kept, of each level; the last level is an hour at 10 kHz."""


@dataclass(frozen=True)
class Window:
    """Some columns over some cycles: `cycles` (n) is where each point begins, `low` and `high` are (columns, n).

    `rows` is how many rows a point stands for at most: with 1 the values are whole, and `low` is `high`. `missing` is
    the number of cycles between the first and the last that have no row: the loop skipped them, or they were lost.
    """

    cycles: Cycles
    low: Values
    high: Values
    rows: int
    missing: int


def extremes(low: Values, high: Values, begins: NDArray[np.intp]) -> tuple[Values, Values]:
    """Least of `low` and greatest of `high` (columns, n) in each part; a part goes from one of `begins` to the next.

    NaN counts only where a part has nothing else.
    """
    return np.fmin.reduceat(low, begins, axis=1), np.fmax.reduceat(high, begins, axis=1)


def blocks_per_point(first: int, last: int, per: int, points: int) -> int:
    """So many blocks of `per` rows are one of about `points` points from cycle `first` to `last`."""
    return max(1, -(-(last - first + 1) // (per * max(1, points))))


def decimated(cycles: Cycles, low: Values, high: Values, per: int, step: int, missing: int) -> Window:
    """Blocks of `per` rows, `step` of them a point. A point begins at a fixed cycle: a moving trace doesn't shimmer."""
    if step > 1 and len(cycles):
        places = cycles // (per * step)
        begins = np.flatnonzero(np.diff(places, prepend=places[0] - 1))
        cycles, (low, high) = cycles[begins], extremes(low, high, begins)
    return Window(cycles, low, high, per * step, missing)


class _Ring:
    """Places of the newest `capacity` of numbered things; each begins at a cycle, and stands for `per` rows."""

    def __init__(self, per: int, capacity: int) -> None:
        self.per, self.capacity, self.count = per, capacity, 0
        self.cycles = np.zeros(capacity, np.int64)

    @property
    def oldest(self) -> int:
        return max(0, self.count - self.capacity)

    def cycle(self, number: int) -> int:
        return int(self.cycles[number % self.capacity])

    def find(self, cycle: int) -> int:
        """Number of the first one that begins at `cycle` or later."""
        return bisect.bisect_left(range(self.count), cycle, lo=self.oldest, key=self.cycle)

    def reaches(self, cycle: int) -> bool:
        """Whether nothing from `cycle` on has been overwritten."""
        return self.count > 0 and (self.oldest == 0 or self.cycle(self.oldest) <= cycle)

    def pieces(self, start: int, stop: int) -> list[slice]:
        """Where `start` to before `stop` are: one or two slices."""
        begin, count = start % self.capacity, max(0, stop - start)
        if begin + count <= self.capacity:
            return [slice(begin, begin + count)]
        return [slice(begin, self.capacity), slice(0, begin + count - self.capacity)]

    def put(self, cycles: Cycles, *pairs: tuple[NDArray[Any], NDArray[Any]]) -> None:
        """`cycles` (n) at the end, and of each pair the second array (..., n) into the first, a ring as well."""
        done = 0
        for piece in self.pieces(self.count, self.count + len(cycles)):
            part = slice(done, done + piece.stop - piece.start)
            for ring, new in ((self.cycles, cycles), *pairs):
                ring[..., piece] = new[..., part]
            done = part.stop
        self.count += len(cycles)


class Blocks(_Ring):
    """Least and greatest value of blocks of `per` rows, of the newest `capacity` blocks."""

    def __init__(self, columns: int, per: int, capacity: int) -> None:
        super().__init__(per, capacity)
        self._low, self._high = np.zeros((2, columns, capacity), np.float32)
        self.memory = (self.cycles, self._low, self._high)

    def add(self, cycles: Cycles, low: Values, high: Values) -> None:
        """Blocks (n), (columns, n) at the end."""
        self.put(cycles, (self._low, low), (self._high, high))

    def taken(self, columns: Sequence[int], start: int, stop: int) -> tuple[Cycles, Values, Values]:
        """Blocks `start` to before `stop`: their cycles (n), least and greatest (columns, n)."""
        pieces = self.pieces(start, stop)
        low, high = (np.concatenate([v[columns, piece] for piece in pieces], axis=1) for v in (self._low, self._high))
        return np.concatenate([self.cycles[piece] for piece in pieces]), low, high


class Rows(_Ring):
    """The newest `capacity` rows, byte for byte."""

    def __init__(self, fields: Sequence[Field], dtype: np.dtype[Any], capacity: int) -> None:
        super().__init__(1, capacity)
        self._fields, self._rows = list(fields), np.zeros(capacity, dtype)
        self.memory = (self.cycles, self._rows.view(np.uint8))

    def add(self, rows: NDArray[Any]) -> None:
        """Rows (n) at the end."""
        self.put(rows["cycle"], (self._rows, rows))

    def whole(self, start: int, stop: int) -> NDArray[Any]:
        """A copy of rows `start` to before `stop`."""
        return np.concatenate([self._rows[piece] for piece in self.pieces(start, stop)])

    def taken(self, columns: Sequence[int], start: int, stop: int) -> tuple[Cycles, Values, Values]:
        """Rows `start` to before `stop` as blocks of one: their cycles (n) and values (columns, n), twice."""
        pieces = self.pieces(start, stop)
        cycles = np.concatenate([self.cycles[piece] for piece in pieces])
        values = np.empty((len(columns), len(cycles)), np.float32)
        for k, column in enumerate(columns):
            values[k] = np.concatenate([self._fields[column].of(self._rows[piece]) for piece in pieces])
        return cycles, values, values


class History:
    """The past of a running cell."""

    def __init__(
        self, fields: Sequence[Field], full_rows: int = FULL_ROWS, blocks: Sequence[tuple[int, int]] = BLOCKS
    ) -> None:
        """`full_rows` is an even multiple of each number of rows in `blocks`, which rise."""
        self.fields = list(fields)
        self._index = {field.name: i for i, field in enumerate(fields)}
        self._rows = Rows(fields, ROW, full_rows)
        self._blocks = [Blocks(len(fields), *block) for block in blocks]
        self._levels: list[Rows | Blocks] = [self._rows, *self._blocks]

    @property
    def nbytes(self) -> int:
        """Memory that it takes at most."""
        return sum(array.nbytes for level in self._levels for array in level.memory)

    def take(self) -> None:
        """Write to all of the memory now: a lack of it shows at once, not an hour later."""
        for level in self._levels:
            for array in level.memory:
                array.fill(0)

    def clear(self) -> None:
        """Forget everything, and keep the memory."""
        for level in self._levels:
            level.count = 0

    def add(self, rows: NDArray[Any]) -> None:
        """Rows of the ring, oldest first, at most as many as there are kept."""
        half = self._rows.capacity // 2  # so that what is in no whole block yet is not overwritten
        for begin in range(0, len(rows), half):
            self._rows.add(rows[begin : begin + half])
            for level in self._blocks:
                self._fill(level)

    def _fill(self, level: Blocks) -> None:
        """Add the blocks that have become whole."""
        first, last = level.count, self._rows.count // level.per
        if last > first:
            cycles, values, _ = self._rows.taken(range(len(self.fields)), first * level.per, last * level.per)
            begins = np.arange(0, len(cycles), level.per)
            level.add(cycles[begins], *extremes(values, values, begins))

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
        return min((level.cycle(level.oldest) for level in self._levels if level.count), default=0)

    @property
    def oldest_full(self) -> int:
        """The oldest cycle that is there as a row."""
        return self._rows.cycle(self._rows.oldest) if self._rows.count else 0

    def index(self, names: Sequence[str]) -> list[int]:
        """Columns of these fields; KeyError where one is unknown."""
        return [self._index[name] for name in names]

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Rows (n) from cycle `first` to `last`, both included, as the loop wrote them, as far as they are there."""
        return self._rows.whole(self._rows.find(first), self._rows.find(last + 1))

    def whole(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, Values]:
        """Values from cycle `first` to `last`, both included, as far as they are there: (n) and (columns, n)."""
        cycles, values, _ = self._rows.taken(columns, self._rows.find(first), self._rows.find(last + 1))
        return cycles, values

    def window(self, columns: Sequence[int], first: int, last: int, points: int) -> Window:
        """From cycle `first` to `last` in at most about `points` points."""
        level = self._level(first, last, points)
        step = blocks_per_point(max(first, level.cycle(level.oldest)), min(last, self.newest), level.per, points)
        begin = first - first % (level.per * step)  # the first point is a whole one, too
        start = level.find(begin) if level.per == 1 else max(level.oldest, level.find(begin + 1) - 1)
        cycles, low, high = level.taken(columns, start, level.find(last + 1))
        span = int(cycles[-1] - cycles[0]) + level.per if len(cycles) else 0
        return decimated(cycles, low, high, level.per, step, max(0, span - len(cycles) * level.per))

    def _level(self, first: int, last: int, points: int) -> Rows | Blocks:
        """The coarsest level that has two blocks a point, of those that reach back to `first`; else the one that
        reaches back furthest.
        """
        best: Rows | Blocks = self._rows
        wanted = (last - first + 1) / max(1, points) / 2
        for level in self._blocks:
            is_older = level.count > 0 and level.cycle(level.oldest) < best.cycle(best.oldest)
            if level.per <= wanted or (is_older and not best.reaches(first)):
                best = level
        return best
