"""What a history is kept in: whole rows as the loop wrote them, and blocks with the least and greatest of many."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .fields import Field

Values = NDArray[np.float32]
Cycles = NDArray[np.int64]


class Level(Protocol):
    """Blocks of `per` rows, `count` of them so far, of which the one of number `oldest` is still there."""

    @property
    def per(self) -> int: ...
    @property
    def count(self) -> int: ...
    @property
    def oldest(self) -> int: ...

    def cycle(self, number: int) -> int:
        """First cycle of a block that is there."""

    def find(self, cycle: int) -> int:
        """Number of the first block that begins at `cycle` or later."""

    def taken(self, columns: Sequence[int], start: int, stop: int) -> tuple[Cycles, Values, Values]:
        """Blocks `start` to before `stop`: their cycles (n), least and greatest (columns, n)."""


class _Ring:
    """Places of the newest `capacity` of things that are numbered."""

    def __init__(self, capacity: int) -> None:
        self.capacity, self.count = capacity, 0
        self.cycles = np.zeros(capacity, np.int64)

    @property
    def oldest(self) -> int:
        return max(0, self.count - self.capacity)

    def cycle(self, number: int) -> int:
        return int(self.cycles[number % self.capacity])

    def find(self, cycle: int) -> int:
        return bisect.bisect_left(range(self.count), cycle, lo=self.oldest, key=self.cycle)

    def pieces(self, start: int, stop: int) -> list[slice]:
        """Where `start` to before `stop` are: one or two slices."""
        begin, count = start % self.capacity, stop - start
        if begin + count <= self.capacity:
            return [slice(begin, begin + count)]
        return [slice(begin, self.capacity), slice(0, begin + count - self.capacity)]


class Blocks(_Ring):
    """Least and greatest value of blocks of `per` rows, of the newest `capacity` blocks."""

    def __init__(self, columns: int, per: int, capacity: int) -> None:
        super().__init__(capacity)
        self.per = per
        self._low, self._high = np.zeros((2, columns, capacity), np.float32)

    def add(self, cycles: Cycles, low: Values, high: Values) -> None:
        """Blocks (n), (columns, n) at the end."""
        done = 0
        for piece in self.pieces(self.count, self.count + len(cycles)):
            part = slice(done, done + piece.stop - piece.start)
            self.cycles[piece], self._low[:, piece], self._high[:, piece] = cycles[part], low[:, part], high[:, part]
            done = part.stop
        self.count += len(cycles)

    def taken(self, columns: Sequence[int], start: int, stop: int) -> tuple[Cycles, Values, Values]:
        pieces = self.pieces(start, max(start, stop))
        return (
            np.concatenate([self.cycles[piece] for piece in pieces]),
            np.concatenate([self._low[columns, piece] for piece in pieces], axis=1),
            np.concatenate([self._high[columns, piece] for piece in pieces], axis=1),
        )

    def take(self) -> None:
        """Have the memory now: zeros are given at the first write."""
        for array in (self.cycles, self._low, self._high):
            array.fill(0)

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        return self.cycles.nbytes + self._low.nbytes + self._high.nbytes


class Rows(_Ring):
    """The newest `capacity` rows, byte for byte."""

    per = 1

    def __init__(self, fields: Sequence[Field], dtype: np.dtype[Any], capacity: int) -> None:
        super().__init__(capacity)
        self._fields, self._rows = list(fields), np.zeros(capacity, dtype)

    def add(self, rows: NDArray[Any]) -> None:
        """Rows (n) at the end."""
        done = 0
        for piece in self.pieces(self.count, self.count + len(rows)):
            part = rows[done : done + piece.stop - piece.start]
            self._rows[piece], self.cycles[piece] = part, part["cycle"]
            done += len(part)
        self.count += len(rows)

    def whole(self, start: int, stop: int) -> NDArray[Any]:
        """A copy of rows `start` to before `stop`."""
        return np.concatenate([self._rows[piece] for piece in self.pieces(start, max(start, stop))])

    def taken(self, columns: Sequence[int], start: int, stop: int) -> tuple[Cycles, Values, Values]:
        pieces = self.pieces(start, max(start, stop))
        values = np.empty((len(columns), sum(piece.stop - piece.start for piece in pieces)), np.float32)
        for k, column in enumerate(columns):
            values[k] = np.concatenate([self._fields[column].of(self._rows[piece]) for piece in pieces])
        return np.concatenate([self.cycles[piece] for piece in pieces]), values, values

    def take(self) -> None:
        """Have the memory now: zeros are given at the first write."""
        for array in (self.cycles, self._rows.view(np.uint8)):
            array.fill(0)

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        return self.cycles.nbytes + self._rows.nbytes
