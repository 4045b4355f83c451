"""Which rows of a table can be used: those with a number in each column, once; what is left out is said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from .table import Array, Table

Flags = NDArray[np.bool_]

_APART = 0.67
"""Where fewer rows are whole than this share of those of the scarcest column, columns were logged apart."""
_NINES = (9999.0, 99999.0, 999999.0, 9.9e37, 9.91e37)
_NO_VALUE, _FAR = (-999.0, *_NINES, *(-nines for nines in _NINES)), 3.0
"""What is written where there is no value, if it is so many strokes away; 999 may be a true blow."""
_LONGEST = 5.0
"""Intervals of a column over which it may be filled in."""


@dataclass(frozen=True)
class Rows:
    """Values (n, k) of the rows that are used, their times (n,), s, and the `number` (n,) of each in the table.

    `lacking` and `repeated` flag, of all rows, those without a number in each column, and those that were there before.
    """

    where: Callable[[int], str]
    number: NDArray[np.int64]
    values: Array
    times: Array
    lacking: Flags
    repeated: Flags
    told: tuple[str, ...] = ()

    def left_out(self, used: NDArray[np.int64], *, whole: bool) -> list[str]:
        """What is to be told of rows between those that are `used`, or of all."""
        first, last = (0, len(self.lacking)) if whole else (int(used[0]), int(used[-1]) + 1)
        said = list(self.told)
        for flags, one, many in (
            (self.lacking, "row lacks a number and is", "rows lack a number and are"),
            (self.repeated, "row repeats the one before and is", "rows repeat the one before and are"),
        ):
            at = np.flatnonzero(flags[first:last]) + first
            if len(at):
                said.append(
                    f"{len(at)} {one if len(at) == 1 else many} left out, the first at {self.where(int(at[0]))}"
                )
        return said


def usable(
    table: Table,
    names: Sequence[str],
    values: Array,
    time_name: str | None,
    t: Array | None,
    *,
    fill: bool,
    clean: bool,
) -> Rows:
    """The rows of `values` (n, k), the columns `names` of `table`, that have all numbers and do not repeat.

    Columns that were logged apart, each at rows of its own, are brought together where `fill`. A value that stands for
    none is none where `clean`. CheckFailed where columns are not to be brought together, and where nothing is left.
    """
    told = []
    for k, name in enumerate(names if clean else ()):
        flags = _stand_for_none(values[:, k])
        if flags.any():
            values = np.where(flags[:, None] & (np.arange(len(names)) == k), np.nan, values)
            told.append(
                f"{name} has {table[name][flags][0]:g} in {flags.sum()} rows, the first at "
                f"{table.where(int(np.argmax(flags)))}, far from all others: taken as no number (--keep-spikes: as one)"
            )
    times = np.arange(len(values), dtype=float) if t is None else t
    found = np.isfinite(values)
    whole = found.all(axis=1) & np.isfinite(times)
    filled = False
    counts = [int(column.sum()) for column in found.T]
    if whole.sum() < _APART * min(counts) and min(counts) > 1:
        each = ", ".join(f"{name} in {count}" for name, count in zip(names, counts, strict=True))
        apart = f"of {len(values)} rows {int(whole.sum())} have all numbers ({each}): they were logged apart"
        if not fill or t is None:
            raise CheckFailed(f"{table.file}: {apart}; bring them together with a column of time and --resample HZ")
        known = np.isfinite(times)
        values = np.column_stack([_filled(times, column, known) for column in values.T])
        scarcest = int(np.argmin(counts))
        whole = np.isfinite(values).all(axis=1) & found[:, scarcest] & known
        filled = True
        told.append(f"{apart}, the others are filled in where {names[scarcest]} is, along {time_name}")
    if not whole.any():
        lacks = [name for name, count in zip(names, counts, strict=True) if count == 0]
        what = f"{lacks[0]} has no number at all" if lacks else f"no row has a number in each of {', '.join(names)}"
        raise CheckFailed(f"{table.where(0)}: {what}; name other columns, or repair the sensor")
    number = np.flatnonzero(whole)
    again = np.zeros(len(values), bool)
    if t is not None:
        again[number[1:]] = _repeated(times[number], values[number])
    number = np.flatnonzero(whole & ~again)
    lacking = np.zeros_like(whole) if filled else ~whole
    return Rows(table.where, number, values[number], times[number], lacking, again, tuple(told))


def _stand_for_none(column: Array) -> Flags:
    """Values (n,) that are nines only, and far from all others."""
    nines = np.isin(column, _NO_VALUE)
    others = column[np.isfinite(column) & ~nines]
    if not nines.any() or not len(others) or np.ptp(others) == 0.0:
        return np.zeros(len(column), bool)
    away = np.abs(column - np.median(others))
    return np.asarray(nines & (away > _FAR * np.ptp(others)))


def _filled(times: Array, column: Array, known: Flags) -> Array:
    """A column (n,) with straight lines between its numbers, where they are not far apart."""
    own = np.flatnonzero(np.isfinite(column) & known)
    at = times[own]
    behind = np.clip(np.searchsorted(at, times), 1, len(at) - 1)
    near = at[behind] - at[behind - 1] <= _LONGEST * np.median(np.diff(at))
    inside = (times >= at[0]) & (times <= at[-1]) & near
    return np.where(inside | np.isfinite(column), np.interp(times, at, column[own]), np.nan)


def _repeated(times: Array, values: Array) -> Flags:
    """Rows (n - 1,), from the second on, that say what the one before said, at its time.

    None where only some rows of a time do: its stamps are coarser than its samples, and two samples may be alike.
    """
    standing = np.diff(times) == 0.0
    alike = standing & np.all(np.diff(values, axis=0) == 0.0, axis=1)
    return alike if alike.sum() == standing.sum() else np.zeros(len(alike), bool)
