"""A long recording as least and greatest values of blocks of cycles, which fill as its pieces are read.

Pieces are read here and there over all of it first, then ever more densely in between: a thread reads, and the server
shows what is there already.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, system_error
from micromanip.faults import KINDS
from micromanip.recordings.telemetry import Piece
from micromanip.rt.states import NO_FAULT

from .fields import Field
from .history import Level

_FINE, _STEP = 32, 32
"""Cycles in a block of the fine level; blocks of it in one of the coarse level."""
_MOST_BYTES = 1_000_000_000
"""With longer blocks for a longer recording."""


class Overview:
    """Of `pieces`, which have the cycles `first` to `last`: `levels`, fine first.

    `notes` are the faults and the damage found so far: cycle, kind (``fault`` or ``damage``), text.
    """

    def __init__(self, folder: Path, pieces: Sequence[Piece], fields: Sequence[Field], first: int, last: int) -> None:
        """Its files go to `folder`. Raises what `errors.system_error` makes of one without room."""
        self._pieces, self._fields, self._first, self._last = pieces, fields, first, last
        self._paths = list(dict.fromkeys(["cycle", "fault", *(field.path for field in fields)]))
        self._order, self._done = halving(len(pieces)), 0
        self.notes: list[tuple[int, str, str]] = []
        per = _FINE
        while (last - first) // per * len(fields) * 8 > _MOST_BYTES:
            per *= 2
        try:
            self.levels = [_level(folder, size, first, last, len(fields)) for size in (per, per * _STEP)]
        except OSError as problem:
            raise system_error(problem, folder) from problem

    @property
    def share(self) -> float:
        """How much of the recording is in it."""
        return self._done / len(self._order)

    def fill(self, goes_on: Callable[[], bool] = lambda: True) -> None:
        """Read the pieces that are not in it yet, as long as `goes_on`; one that can't be read is noted."""
        while self._done < len(self._order) and goes_on():
            self._add(int(self._order[self._done]))
            self._done += 1

    def _add(self, number: int) -> None:
        try:
            columns = self._pieces[number](self._paths)
        except CheckFailed as problem:
            self._note_damage(number, str(problem))
            return
        cycles, faults = columns["cycle"], columns["fault"]
        if not len(cycles):
            return
        values = np.array([field.shown(columns[field.path]) for field in self._fields], np.float32)
        for level in self.levels:
            level.add(cycles, values)
        if faults.any():
            follows = number > 0 and faults[0] != NO_FAULT
            before = (self._edge(number - 1, "fault", -1) if follows else None) or NO_FAULT
            for k in np.flatnonzero((np.diff(faults, prepend=before) != 0) & (faults != NO_FAULT)):
                kind = KINDS.get(int(faults[k]))
                name = f"fault {faults[k]}" if kind is None else f"{kind.code} {kind.name}"
                self.notes.append((int(cycles[k]), "fault", name))

    def _note_damage(self, number: int, why: str) -> None:
        """The cycles between the pieces beside it; neighbours that are damaged as well are noted once."""
        before = (self._edge(k, "cycle", -1) for k in range(number - 1, -1, -1))
        after = (self._edge(k, "cycle", 0) for k in range(number + 1, len(self._pieces)))
        begin = next((found + 1 for found in before if found is not None), self._first)
        end = next((found - 1 for found in after if found is not None), self._last)
        note = (begin, "damage", f"damaged: {end - begin + 1} cycles can't be read ({why})")
        if note not in self.notes:
            self.notes.append(note)

    def _edge(self, number: int, path: str, place: int) -> int | None:
        """The first or last value of a column of a piece; None where there is none to be read."""
        try:
            values = self._pieces[number]([path])[path]
        except CheckFailed:
            return None
        return int(values[place]) if len(values) else None


def halving(count: int) -> NDArray[np.int64]:
    """0 to `count` - 1, each in the middle of the largest gap that those before have left, about."""
    bits = max(1, int(count - 1).bit_length())
    turned = np.zeros(1 << bits, np.int64)
    for bit in range(bits):
        turned |= ((np.arange(1 << bits) >> bit) & 1) << (bits - 1 - bit)
    return np.asarray(turned[turned < count])


def _level(folder: Path, per: int, first: int, last: int, fields: int) -> Level:
    """With room for all blocks, in files: a block's values lie together, which fills three times as fast."""
    blocks = (last - first) // per + 1
    low, high = (_made(folder / f"{name}-{per}", np.float32, (blocks, fields)) for name in ("low", "high"))
    return Level(per, first, _made(folder / f"count-{per}", np.int32, (blocks,)), low, high)


def _made(file: Path, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Zeros in a new file, for which there is room."""
    with file.open("wb") as made:
        os.posix_fallocate(made.fileno(), 0, int(np.prod(shape)) * np.dtype(kind).itemsize)
    return np.memmap(file, kind, "r+", shape=shape)
