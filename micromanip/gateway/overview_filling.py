"""Reads a recording into its overview: first here and there over all of it, then ever more densely in between.

A process of its own, so that the server answers meanwhile:
``python -m micromanip.gateway.overview_filling FILE FOLDER``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from micromanip.errors import CheckFailed, MicromanipError
from micromanip.faults import KINDS
from micromanip.recordings import open_telemetry
from micromanip.recordings.telemetry import Piece
from micromanip.rt.states import NO_FAULT

from .fields import Field, fields
from .overview import Overview, reopened


def fill(
    pieces: Sequence[Piece], shown: Sequence[Field], overview: Overview, goes_on: Callable[[], bool] = lambda: True
) -> None:
    """Every piece that is not in the overview yet, as long as `goes_on`; one that can't be read is noted there."""
    paths = list(dict.fromkeys(["cycle", "fault", *(field.path for field in shown)]))
    first, span = overview.about["first"], overview.about["last"] - overview.about["first"] + 1
    for number in _in_turn(overview, len(pieces), first, span):
        if not goes_on():
            return
        try:
            columns = pieces[number](paths)
        except CheckFailed as problem:
            _note_damage(pieces, number, overview, str(problem))
            overview.done[number] = 1
            continue
        if not len(columns["cycle"]):
            overview.done[number] = 1
            continue
        values = np.array([field.shown(columns[field.path]) for field in shown], np.float32)
        for level in overview.levels:
            level.add(columns["cycle"], values)
        faults = columns["fault"]
        if faults.any():
            follows = number > 0 and faults[0] != NO_FAULT
            before = (_edge(pieces, number - 1, "fault", -1) if follows else None) or NO_FAULT
            for k in np.flatnonzero((np.diff(faults, prepend=before) != 0) & (faults != NO_FAULT)):
                cycle = int(columns["cycle"][k])
                overview.note(cycle, cycle, "fault", _fault_name(int(faults[k])))
        overview.done[number] = 1


def _note_damage(pieces: Sequence[Piece], number: int, overview: Overview, why: str) -> None:
    """The cycles between the pieces beside it; those of neighbours that are damaged as well are noted with them."""
    last = next(
        (found for k in range(number - 1, -1, -1) if (found := _edge(pieces, k, "cycle", -1)) is not None), None
    )
    first = next(
        (found for k in range(number + 1, len(pieces)) if (found := _edge(pieces, k, "cycle", 0)) is not None), None
    )
    begin = overview.about["first"] if last is None else last + 1
    end = overview.about["last"] if first is None else first - 1
    overview.note(begin, end, "damage", f"damaged: {end - begin + 1} cycles can't be read ({why})")


def _fault_name(number: int) -> str:
    kind = KINDS.get(number)
    return f"fault {number}" if kind is None else f"{kind.code} {kind.name}"


def _edge(pieces: Sequence[Piece], number: int, path: str, place: int) -> int | None:
    """The first or last value of a column of a piece; None where there is none to be read."""
    try:
        values = pieces[number]([path])[path]
    except CheckFailed:
        return None
    return int(values[place]) if len(values) else None


def _in_turn(overview: Overview, count: int, first: int, span: int) -> Iterator[int]:
    """Numbers of pieces: those of the cycles that are looked at before others."""
    order, near, place, wanted = halving(count), np.empty(0, np.int64), 0, (0, 0)
    while True:
        low, high = ((int(cycle) - first) * count // span for cycle in overview.wanted)
        if (low, high) != wanted:
            wanted, begin = (low, high), max(0, low - 1)
            near = begin + halving(min(count, high + 2) - begin) if 0 < high - low < count else near[:0]
        near = near[overview.done[near] == 0]
        while place < count and overview.done[order[place]]:
            place += 1
        if len(near):
            yield int(near[0])
        elif place < count:
            yield int(order[place])
        else:
            return


def halving(count: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """0 to `count` - 1, each in the middle of the largest gap that those before have left, about."""
    if count < 1:
        return np.empty(0, np.int64)
    bits = max(1, int(count - 1).bit_length())
    turned = np.zeros(1 << bits, np.int64)
    for bit in range(bits):
        turned |= ((np.arange(1 << bits) >> bit) & 1) << (bits - 1 - bit)
    return np.asarray(turned[turned < count])


def main(file: Path, folder: Path) -> int:
    """Fill until it is whole, or the process that asked for it is gone; the exit code."""
    overview, parent = reopened(folder), os.getppid()
    try:
        telemetry = open_telemetry(file)
        fill(telemetry.pieces(), fields(telemetry.axes, telemetry.dtype), overview, lambda: os.getppid() == parent)
    except MicromanipError as problem:
        sys.stderr.write(f"micromanip: the overview stays as it is: {problem}\n")
        return problem.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
