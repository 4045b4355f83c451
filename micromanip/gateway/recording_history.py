"""A recording as the scope's past: short windows come from the file, long ones from the overview of the file."""

from __future__ import annotations

import bisect
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry

from .fields import Field
from .history import Cycles, Level, Past, Values, Window
from .overview import Overview

_ROWS_READ = 10_000
"""Cycles of a window up to which its rows are read: twenty pieces of a recording, less than 100 ms."""
_KEPT = 2048
"""Pieces whose columns are remembered."""
_MOST_MARKS = 200


class RecordedHistory(Past):
    """A whole recording, whose `overview` somebody fills meanwhile."""

    def __init__(self, telemetry: Telemetry, fields: Sequence[Field], folder: Path) -> None:
        """The overview goes to `folder`. CheckFailed where the recording is damaged, or empty."""
        super().__init__(fields)
        self.pieces = telemetry.pieces()
        if not self.pieces:
            raise CheckFailed(f"{telemetry.file}: there are no rows in it")
        self._prefix = f"{telemetry.file}: "
        self._begin: dict[int, int] = {}
        self._known: OrderedDict[int, dict[str, NDArray[Any]]] = OrderedDict()
        ends = (self._read(piece, ["cycle"])["cycle"] for piece in reversed(range(len(self.pieces))))
        newest = next((cycle[-1] for cycle in ends if len(cycle)), None)
        if newest is None:
            raise CheckFailed(f"{telemetry.file}: it is damaged: none of its rows can be read")
        self.newest = int(newest)
        self.oldest = self.oldest_full = self._first(0)
        self.count = int(telemetry.end.get("rows") or self.newest - self.oldest + 1)
        self.overview = Overview(folder, self.pieces, self.fields, self.oldest, self.newest)
        self._remarks = [(int(m["cycle"]), "mark", f"{m['text']} ({m['by']})") for m in telemetry.marks]

    @property
    def marks(self) -> list[tuple[int, str, str]]:
        """Remarks, and faults and damage as far as they are known: cycle, kind, text."""
        found = [(cycle, kind, text.replace(self._prefix, "")) for cycle, kind, text in self.overview.notes]
        return sorted(self._remarks + found)[:_MOST_MARKS]

    def whole(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, Values]:
        """Values from cycle `first` to `last`, both included: (n) and (columns, n)."""
        fields = [self.fields[column] for column in columns]
        paths = ["cycle", *dict.fromkeys(field.path for field in fields)]
        cycles: list[Cycles] = [np.empty(0, np.int64)]
        values: list[Values] = [np.empty((len(fields), 0), np.float32)]
        for piece in range(self._holding(first), len(self.pieces)):
            if piece and self._first(piece) > last:
                break
            found = self._read(piece, paths)
            part = slice(*np.searchsorted(found["cycle"], [first, last + 1]))
            cycles.append(found["cycle"][part].astype(np.int64))
            values.append(np.array([field.shown(found[field.path][part]) for field in fields], np.float32))
        return np.concatenate(cycles), np.concatenate(values, axis=1)

    def level(self, first: int, last: int, points: int) -> Level | None:
        """None for what is soon read; else the coarsest level with a block a point."""
        if last - first < _ROWS_READ:
            return None
        levels = self.overview.levels
        return next((each for each in reversed(levels) if (last - first) // each.per >= points), levels[0])

    @property
    def is_complete(self) -> bool:  # type: ignore[override]
        """Whether all of it is in the overview."""
        return self.overview.share == 1.0

    def window(self, columns: Sequence[int], first: int, last: int, points: int) -> Window:
        """From cycle `first` to `last`; NaN where the overview has nothing yet, and where nothing can be read."""
        shown = super().window(columns, first, last, points)
        for begin, kind, _ in self.overview.notes:
            if kind == "damage" and first <= begin <= last:
                shown = _parted(shown, begin)
        return shown

    def _holding(self, cycle: int) -> int:
        """The piece in which the cycle is, or would be."""
        return max(0, bisect.bisect_right(range(len(self.pieces)), cycle, key=self._first) - 1)

    def _first(self, piece: int) -> int:
        """First cycle of a piece, which is read for it once; of one that can't be read, that of the next."""
        if piece not in self._begin:
            cycles = (self._read(later, ["cycle"])["cycle"] for later in range(piece, len(self.pieces)))
            self._begin[piece] = next((int(cycle[0]) for cycle in cycles if len(cycle)), self.newest + 1)
        return self._begin[piece]

    def _read(self, piece: int, paths: Sequence[str]) -> dict[str, NDArray[Any]]:
        known = self._known.setdefault(piece, {})
        self._known.move_to_end(piece)
        if missing := [path for path in paths if path not in known]:
            try:
                known.update(self.pieces[piece](missing))
            except CheckFailed:  # the overview says so, and where
                known.update({path: np.empty(0, np.int64) for path in missing})
        if len(self._known) > _KEPT:
            self._known.popitem(last=False)
        return known


def _parted(window: Window, cycle: int) -> Window:
    """With a point at `cycle` where nothing is known: no line goes over it."""
    at = int(np.searchsorted(window.cycles, cycle))
    low, high = (np.insert(each, at, np.nan, axis=1) for each in (window.low, window.high))
    return Window(np.insert(window.cycles, at, cycle), low, high, window.rows, window.missing)
