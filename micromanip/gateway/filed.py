"""A recording as the scope's past: all of it as least and greatest of blocks, made once; its rows stay in the file."""

from __future__ import annotations

import bisect
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.recordings import Telemetry
from micromanip.recordings.telemetry import Again
from micromanip.rt.states import NO_FAULT

from .fields import Field
from .history import Past
from .levels import Blocks, Cycles, Values

_SHORT, _LONG = 16, 1024
"""Rows in a block of each level."""
_KEPT = 4096
"""Pieces of the file whose columns are remembered."""
_MOST_MARKS = 200


class FiledRows:
    """The rows of a recording, column by column, read again where they are asked for."""

    per, oldest = 1, 0

    def __init__(self, fields: Sequence[Field]) -> None:
        self.count = 0
        self._fields = list(fields)
        self._again: list[Again] = []
        self._first: list[int] = []
        self._cycle: list[int] = []
        self._known: OrderedDict[int, dict[str, NDArray[Any]]] = OrderedDict()
        self._newest = -1

    def add(self, rows: NDArray[Any], again: Again) -> None:
        """The next piece."""
        self._again.append(again)
        self._first.append(self.count)
        self._cycle.append(int(rows["cycle"][0]))
        self.count += len(rows)
        self._newest = int(rows["cycle"][-1])

    def cycle(self, number: int) -> int:
        if number == self.count - 1:
            return self._newest
        piece = bisect.bisect_right(self._first, number) - 1
        offset = number - self._first[piece]
        return int(self._read(piece, ["cycle"])["cycle"][offset]) if offset else self._cycle[piece]

    def find(self, cycle: int) -> int:
        if cycle > self._newest:
            return self.count
        piece = max(0, bisect.bisect_left(self._cycle, cycle + 1) - 1)
        return self._first[piece] + int(np.searchsorted(self._read(piece, ["cycle"])["cycle"], cycle))

    def taken(self, columns: Sequence[int], start: int, stop: int) -> tuple[Cycles, Values, Values]:
        stop = max(start, min(stop, self.count))
        fields = [self._fields[column] for column in columns]
        paths = ["cycle", *dict.fromkeys(field.path for field in fields)]
        values, cycles = np.empty((len(fields), stop - start), np.float32), np.empty(stop - start, np.int64)
        at = start
        while at < stop:
            piece = bisect.bisect_right(self._first, at) - 1
            found = self._read(piece, paths)
            begin = at - self._first[piece]
            part = slice(begin, min(len(found["cycle"]), begin + stop - at))
            to = slice(at - start, at - start + part.stop - part.start)
            cycles[to] = found["cycle"][part]
            for k, field in enumerate(fields):
                values[k, to] = field.shown(found[field.path][part])
            at += part.stop - part.start
        return cycles, values, values

    def _read(self, piece: int, paths: Sequence[str]) -> dict[str, NDArray[Any]]:
        known = self._known.setdefault(piece, {})
        self._known.move_to_end(piece)
        if missing := [path for path in paths if path not in known]:
            known.update(self._again[piece](missing))
        if len(self._known) > _KEPT:
            self._known.popitem(last=False)
        return known


class Filed(Past):
    """A whole recording. `marks` are its faults and remarks: cycle, kind (``fault`` or ``mark``) and text."""

    def __init__(self, telemetry: Telemetry, fields: Sequence[Field], tell: Callable[[int], None]) -> None:
        """Walks the file once; `tell` hears how many rows so far. CheckFailed where it is damaged, or empty."""
        self._filed = FiledRows(fields)
        self.marks: list[tuple[int, str, str]] = []
        kept: list[list[tuple[Cycles, Values, Values]]] = [[], []]
        for rows in _in_whole_blocks(self._walked(telemetry, tell)):
            values = np.stack([np.asarray(field.of(rows), np.float32) for field in fields])
            low = high = values
            for level, per, step in ((kept[0], _SHORT, _SHORT), (kept[1], _LONG, _LONG // _SHORT)):
                low, high = _reduced(np.fmin, low, step), _reduced(np.fmax, high, step)
                level.append((rows["cycle"][::per].astype(np.int64), low, high))
        if not self._filed.count:
            raise CheckFailed(f"{telemetry.file}: there are no rows in it")
        blocks = [_level(parts, per) for parts, per in zip(kept, (_SHORT, _LONG), strict=True)]
        super().__init__(fields, self._filed, blocks)
        marks = [(int(m["cycle"]), "mark", f"{m['text']} ({m['by']})") for m in telemetry.marks]
        self.marks = sorted(self.marks + marks)[:_MOST_MARKS]

    def _walked(self, telemetry: Telemetry, tell: Callable[[int], None]) -> Iterator[NDArray[Any]]:
        fault = NO_FAULT
        for rows, again in telemetry.pieces():
            if not len(rows):
                continue
            self._filed.add(rows, again)
            before = np.concatenate([[fault], rows["fault"][:-1]])
            for k in np.flatnonzero((rows["fault"] != before) & (rows["fault"] != NO_FAULT)):
                self.marks.append((int(rows["cycle"][k]), "fault", _named(int(rows["fault"][k]))))
            fault = int(rows["fault"][-1])
            tell(self._filed.count)
            yield rows


def _in_whole_blocks(parts: Iterator[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """The same rows, a multiple of the longest block at a time; what is left at the end comes as it is."""
    held: list[NDArray[Any]] = []
    for rows in parts:
        held.append(rows)
        if sum(map(len, held)) >= 8 * _LONG:
            together = np.concatenate(held)
            whole = len(together) // _LONG * _LONG
            yield together[:whole]
            held = [together[whole:]]
    if held and len(rest := np.concatenate(held)):
        yield rest


def _reduced(what: Any, values: Values, step: int) -> Values:
    return np.asarray(what.reduceat(values, np.arange(0, values.shape[1], step), axis=1))


def _level(parts: list[tuple[Cycles, Values, Values]], per: int) -> Blocks:
    level = Blocks(len(parts[0][1]), per, sum(len(cycles) for cycles, _, _ in parts))
    while parts:
        level.add(*parts.pop(0))
    return level


def _named(fault: int) -> str:
    kind = KINDS.get(fault)
    return f"fault {fault}" if kind is None else f"{kind.code} {kind.name}"
