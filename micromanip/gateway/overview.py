"""A long recording as least and greatest values of blocks of cycles, in files that fill as its pieces are read.

One process fills them, another shows what is there already.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import system_error

from .fields import Field
from .history import Cycles, Values, extremes

_FINE, _STEP = 32, 32
"""Cycles in a block of the fine level; blocks of it in one of the coarse level."""
_MOST_BYTES = 1_000_000_000
"""With longer blocks for a longer recording."""


class Level:
    """Blocks of `per` cycles from the cycle `origin` on: `count` (n,) rows in each so far, 0 where none is known.

    `low` and `high` are (n, fields): what is read together lies together, which fills three times as fast.
    """

    def __init__(self, per: int, origin: int, count: NDArray[np.int32], low: Values, high: Values) -> None:
        self.per, self.origin = per, origin
        self.count, self._low, self._high = count, low, high

    def add(self, cycles: Cycles, values: Values) -> None:
        """Rows (n,) in order, their values (fields, n)."""
        blocks = (cycles - self.origin) // self.per
        begins = np.flatnonzero(np.diff(blocks, prepend=-1))
        at = blocks[begins]
        low, high = (each.T for each in extremes(values, values, begins))
        new = (self.count[at] == 0)[:, None]
        self._low[at] = np.where(new, low, np.fmin(self._low[at], low))
        self._high[at] = np.where(new, high, np.fmax(self._high[at], high))
        self.count[at] += np.diff(begins, append=len(cycles)).astype(np.int32)

    def taken(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, NDArray[np.int32], Values, Values]:
        """Of the blocks that have cycles from `first` to `last`: where they begin, rows (n,), least and greatest."""
        part = slice(max(0, (first - self.origin) // self.per), max(0, (last - self.origin) // self.per + 1))
        count = np.array(self.count[part])
        begins = self.origin + self.per * np.arange(part.start, part.start + len(count), dtype=np.int64)
        low, high = (np.array(values[part][:, columns]).T for values in (self._low, self._high))
        low[:, count == 0] = high[:, count == 0] = np.nan
        return begins, count, low, high


class Overview:
    """That of a folder: `levels`, fine first; `done` (pieces,), which are in it; `wanted`, cycles to read first."""

    def __init__(self, folder: Path, about: dict[str, Any]) -> None:
        self.folder, self.about = folder, about
        self.done = _mapped(folder / "done", np.uint8, (about["pieces"],))
        self.wanted = _mapped(folder / "wanted", np.int64, (2,))
        self.levels = []
        for k, (per, blocks) in enumerate(about["levels"]):
            shape = (blocks, len(about["fields"]))
            count = _mapped(folder / f"count-{k}", np.int32, (blocks,))
            low, high = (_mapped(folder / f"{name}-{k}", np.float32, shape) for name in ("low", "high"))
            self.levels.append(Level(per, about["first"], count, low, high))

    @property
    def share(self) -> float:
        """How much of the recording is in it."""
        return float(np.count_nonzero(self.done)) / len(self.done)

    def notes(self) -> list[tuple[int, int, str, str]]:
        """Faults and damage found so far: first and last cycle, kind (``fault`` or ``damage``), text."""
        try:
            lines = (self.folder / "notes").read_text().splitlines()
        except FileNotFoundError:
            return []
        found = (line.split(" ", 3) for line in lines)
        return sorted({(int(first), int(last), kind, text) for first, last, kind, text in found})

    def note(self, first: int, last: int, kind: str, text: str) -> None:
        """One more of `notes`."""
        with (self.folder / "notes").open("a") as notes:
            notes.write(f"{first} {last} {kind} {text.splitlines()[0]}\n")


def made_overview(folder: Path, fields: Sequence[Field], first: int, last: int, pieces: int) -> Overview:
    """An empty one in `folder`, of a recording of the cycles `first` to `last` in so many pieces.

    Raises what `errors.system_error` makes of a folder without room.
    """
    names = [field.name for field in fields]
    per = _FINE
    while (last - first) // per * len(names) * 8 > _MOST_BYTES:
        per *= 2
    levels = [[size, (last - first) // size + 1] for size in (per, per * _STEP)]
    about = {"first": first, "last": last, "pieces": pieces, "fields": names, "levels": levels}
    sizes = {"done": pieces, "wanted": 16}
    for k, (_, blocks) in enumerate(levels):
        values = 4 * blocks * len(names)
        sizes |= {f"count-{k}": 4 * blocks, f"low-{k}": values, f"high-{k}": values}
    try:
        for file, size in sizes.items():
            with (folder / file).open("wb") as made:
                os.posix_fallocate(made.fileno(), 0, size)
        (folder / "about.json").write_text(json.dumps(about))
    except OSError as problem:
        raise system_error(problem, folder) from problem
    return Overview(folder, about)


def reopened(folder: Path) -> Overview:
    """One that `made_overview` has made."""
    return Overview(folder, json.loads((folder / "about.json").read_text()))


def _mapped(file: Path, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    return np.memmap(file, kind, "r+", shape=shape)
