"""The past that the scope shows: the last minute row by row, the last hour as least and greatest of short blocks.

Memory is fixed. The scope asks for a window of cycles and for a number of points across it. It gets the least and
greatest value of each point, so no peak is lost, however far one zooms out.
"""

from __future__ import annotations

import bisect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.telemetry import ROW

from .fields import Field

Values = NDArray[np.float32]
Cycles = NDArray[np.int64]
Counts = NDArray[np.int32]

FULL_ROWS = 600 * 1024
"""61 s at 10 kHz."""
BLOCKS = ((16, FULL_ROWS // 16), (256, 141_312), (4096, 8_832))
"""Cycles in a block and number of blocks kept, of each level; the last two levels are an hour at 10 kHz."""


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


def places(start: int, stop: int, size: int) -> list[slice]:
    """Where numbers `start` to before `stop` are in a ring: one or two slices."""
    begin, count = start % size, max(0, stop - start)
    if begin + count <= size:
        return [slice(begin, begin + count)]
    return [slice(begin, size), slice(0, begin + count - size)]


class Level:
    """Least and greatest values of the newest blocks of `per` cycles, counted from the cycle `origin` on, in a ring."""

    def __init__(self, per: int, origin: int, count: Counts, low: Values, high: Values) -> None:
        """`count` (n,) is how many rows a block has, 0 where none is known; `low` and `high` are (n, columns)."""
        self.per, self._origin, self.memory = per, origin, (count, low, high)
        self._count, self._low, self._high = self.memory
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._count[:] = 0
        self._first, self._last = np.iinfo(np.int64).max, -1

    @property
    def _oldest(self) -> int:
        return max(self._first, self._last + 1 - len(self._count))

    @property
    def oldest(self) -> int:
        """The cycle at which the oldest block begins."""
        return self._origin + self.per * self._oldest

    def reaches(self, cycle: int) -> bool:
        """Whether nothing from `cycle` on has been overwritten."""
        return self._oldest == self._first or self.oldest <= cycle

    def add(self, cycles: Cycles, values: Values) -> None:
        """Rows (n,) in order, their values (columns, n). NaN counts only where a block has nothing else."""
        size, blocks = len(self._count), (cycles - self._origin) // self.per
        if (old := int(np.searchsorted(blocks, blocks[-1] - size, side="right"))) > 0:
            blocks, values = blocks[old:], values[:, old:]
        begins = np.flatnonzero(np.diff(blocks, prepend=-1))
        found = blocks[begins]
        first, last = int(found[0]), int(found[-1])
        self._count[np.arange(max(self._last, last - size) + 1, last + 1) % size] = 0  # of what was there before
        self._first, self._last = min(self._first, first), max(self._last, last)
        at = found % size
        new = (self._count[at] == 0)[:, None]
        low, high = np.fmin.reduceat(values, begins, axis=1).T, np.fmax.reduceat(values, begins, axis=1).T
        self._low[at] = np.where(new, low, np.fmin(self._low[at], low))
        self._high[at] = np.where(new, high, np.fmax(self._high[at], high))
        self._count[at] += np.diff(begins, append=len(blocks)).astype(np.int32)

    def taken(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, Counts, Values, Values]:
        """Of the blocks that have cycles from `first` to `last`: where they begin, rows (n,), least and greatest."""
        begin, end = ((cycle - self._origin) // self.per for cycle in (first, last))
        begin, end = max(begin, self._oldest), min(end, self._last) + 1
        pieces = places(begin, end, len(self._count))
        count = np.concatenate([self._count[piece] for piece in pieces])
        low, high = (
            np.concatenate([each.T[columns, piece] for piece in pieces], axis=1) for each in (self._low, self._high)
        )
        return self._origin + self.per * (begin + np.arange(len(count), dtype=np.int64)), count, low, high


class Past(ABC):
    """What windows are taken of: rows, and levels of blocks of them."""

    newest: int
    """The newest cycle; -1 before the first."""
    oldest_full: int
    """The oldest cycle that is there as a row."""
    is_complete = True
    """What is in no block is missing, not unknown."""

    def __init__(self, fields: Sequence[Field]) -> None:
        self.fields = list(fields)
        self._index = {field.name: i for i, field in enumerate(fields)}

    def index(self, names: Sequence[str]) -> list[int]:
        """Columns of these fields; KeyError where one is unknown."""
        return [self._index[name] for name in names]

    @abstractmethod
    def whole(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, Values]:
        """Values from cycle `first` to `last`, both included, as far as they are there: (n) and (columns, n)."""

    @abstractmethod
    def level(self, first: int, last: int, points: int) -> Level | None:
        """What a window is to be taken from; None: from the rows."""

    def window(self, columns: Sequence[int], first: int, last: int, points: int) -> Window:
        """From cycle `first` to `last` in at most about `points` points; NaN where it is not known.

        A point begins at a fixed cycle: a moving trace doesn't shimmer.
        """
        level = self.level(first, last, points)
        per, oldest = (1, self.oldest_full) if level is None else (level.per, level.oldest)
        span = min(last, self.newest) - max(first, oldest) + 1
        step = max(1, -(-span // (per * max(1, points))))
        begin = first - first % (per * step)  # the first point is a whole one, too
        missing = 0
        if level is None:
            cycles, low = self.whole(columns, begin, last)
            high = low
            missing = int(cycles[-1] - cycles[0]) + 1 - len(cycles) if len(cycles) else 0
        else:
            cycles, count, low, high = level.taken(columns, begin, last)
            known = count > 0
            if self.is_complete:
                missing = int(np.sum(per - count[1:-1]))
            if not known.all():
                low[:, ~known] = high[:, ~known] = np.nan
                kept = known | (not self.is_complete)
                cycles, low, high = cycles[kept], low[:, kept], high[:, kept]
        if step > 1 and len(cycles):
            places = cycles // (per * step)
            begins = np.flatnonzero(np.diff(places, prepend=places[0] - 1))
            cycles = cycles[begins]
            low, high = np.fmin.reduceat(low, begins, axis=1), np.fmax.reduceat(high, begins, axis=1)
        return Window(cycles, low, high, per * step, missing)


class History(Past):
    """The past of a running cell: the newest `full_rows` rows, byte for byte, and blocks."""

    def __init__(
        self, fields: Sequence[Field], full_rows: int = FULL_ROWS, blocks: Sequence[tuple[int, int]] = BLOCKS
    ) -> None:
        """`blocks` are cycles in a block and how many of them, rising."""
        super().__init__(fields)
        self._rows = np.zeros(full_rows, ROW)
        self._levels = [
            # a column of many blocks is read far more often than a block of all columns is written
            Level(per, 0, np.zeros(count, np.int32), *(np.zeros((len(fields), count), np.float32).T for _ in range(2)))
            for per, count in blocks
        ]
        self._memory = [self._rows.view(np.uint8), *(array for level in self._levels for array in level.memory)]
        self._begun = self.count = 0
        """The first cycle; rows that have been added so far."""

    @property
    def nbytes(self) -> int:
        """Memory that it takes at most."""
        return sum(array.nbytes for array in self._memory)

    def take(self) -> None:
        """Write to all of the memory now: a lack of it shows at once, not an hour later."""
        for array in self._memory:
            array.fill(0)

    def clear(self) -> None:
        """Forget everything, and keep the memory."""
        self.count = 0
        for level in self._levels:
            level.clear()

    def add(self, rows: NDArray[Any]) -> None:
        """Rows of the ring, oldest first, at most as many as there are kept."""
        if self.count == 0:
            self._begun = int(rows["cycle"][0])
        done = 0
        for piece in places(self.count, self.count + len(rows), len(self._rows)):
            self._rows[piece] = rows[done : done + piece.stop - piece.start]
            done += piece.stop - piece.start
        self.count += len(rows)
        values = np.array([field.of(rows) for field in self.fields], np.float32)
        for level in self._levels:
            level.add(rows["cycle"], values)

    def _cycle(self, number: int) -> int:
        return int(self._rows["cycle"][number % len(self._rows)])

    def _parts(self, first: int, last: int) -> list[NDArray[Any]]:
        """The rows from cycle `first` to `last`, in one or two arrays."""
        numbers, oldest = range(self.count), max(0, self.count - len(self._rows))
        start, stop = (bisect.bisect_left(numbers, cycle, lo=oldest, key=self._cycle) for cycle in (first, last + 1))
        return [self._rows[piece] for piece in places(start, stop, len(self._rows))]

    @property
    def newest(self) -> int:  # type: ignore[override]  # it moves on
        """The newest cycle; -1 before the first."""
        return self._cycle(self.count - 1) if self.count else -1

    @property
    def oldest(self) -> int:
        """The oldest cycle of which something is known."""
        return max(self._begun, min(level.oldest for level in self._levels)) if self.count else 0

    @property
    def oldest_full(self) -> int:  # type: ignore[override]
        """The oldest cycle that is there as a row."""
        return self._cycle(max(0, self.count - len(self._rows))) if self.count else 0

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Rows (n) from cycle `first` to `last`, both included, as the loop wrote them, as far as they are there."""
        return np.concatenate(self._parts(first, last))

    def whole(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, Values]:
        """Of the rows that are kept."""
        parts = self._parts(first, last)
        cycles = np.concatenate([part["cycle"] for part in parts])
        values = np.empty((len(columns), len(cycles)), np.float32)
        for k, column in enumerate(columns):
            values[k] = np.concatenate([self.fields[column].of(part) for part in parts])
        return cycles, values

    def level(self, first: int, last: int, points: int) -> Level | None:
        """The coarsest with two blocks a point of those that reach back to `first`, else the one that goes furthest."""
        best: Level | None = None
        wanted, oldest = (last - first + 1) / max(1, points) / 2, self.oldest_full
        reaches = self.count <= len(self._rows) or oldest <= first
        for level in self._levels if self.count else ():
            if level.per <= wanted or (level.oldest < oldest and not reaches):
                best, oldest, reaches = level, level.oldest, level.reaches(first)
        return best
