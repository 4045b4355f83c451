"""The path deviation of a robot as a file: a column of time, and one a axis, ``deviation_x_um`` or ``x (mm)``.

Deviation is where the spindle has to go by the stage: the path as it was commanded minus where the robot is, in the
axes of the cell. Any table that ``reading.py`` takes will do; the names state the units, which are never guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, did_you_mean

from .reading import read_table
from .table import Table
from .units import known, split_unit

Array = NDArray[np.float64]

_EVEN = 0.01
"""Share of the interval that a step between rows may differ from it."""
_LARGEST_UM = 1e5
"""A deviation beyond 100 mm is none: a position, or another unit."""


@dataclass(frozen=True)
class PathDeviation:
    """Deviation (n, axes) in um at rising times (n,) in s from the first row; `notes` say what was made of units."""

    file: Path
    axes: tuple[str, ...]
    time_s: Array
    deviation_um: Array
    notes: tuple[str, ...] = ()

    def even_step_s(self) -> float:
        """Interval of its rows. CheckFailed, with the row, where they are not even."""
        steps = np.diff(self.time_s)
        step = float(np.median(steps))
        uneven = np.flatnonzero(np.abs(steps - step) > _EVEN * step)
        if len(uneven):
            k = int(uneven[0])
            raise CheckFailed(
                f"{self.file}: row {k + 1} comes {steps[k]:.6g} s after the one before, the others {step:.6g} s: rows "
                "that are played must be even"
            )
        return float(self.time_s[-1] / len(steps))


def read_path_deviation(file: Path, axes: Sequence[str]) -> PathDeviation:
    """The deviation of `axes` in `file`. CheckFailed, with file and line, for what is not one."""
    table = read_table(file)
    time_name = table.time_column()
    if time_name is None:
        raise CheckFailed(f"{file}: no column is a time; call it t_s. Its columns are {', '.join(table)}")
    time_s, time_note = _in_unit(table, time_name, "time", "s")
    _refuse_gaps(table, time_name, time_s)
    falls = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(falls):
        k = int(falls[0])
        what = "stands still" if time_s[k + 1] == time_s[k] else f"falls by {time_s[k] - time_s[k + 1]:.6g} s"
        raise CheckFailed(f"{table.where(k + 1)}: {time_name} {what} here; time rises from row to row")
    if len(time_s) < 2:
        raise CheckFailed(f"{table.where(0)}: one row is no path")
    columns, notes = [], [*table.notes, time_note]
    for axis in axes:
        name = _column(table, axis)
        values, note = _in_unit(table, name, "length", "um")
        _refuse_gaps(table, name, values)
        far = np.flatnonzero(np.abs(values) > _LARGEST_UM)
        if len(far):
            k = int(far[0])
            raise CheckFailed(
                f"{table.where(k)}: {name} is {values[k] * 1e-3:.6g} mm: a deviation is the path as commanded minus "
                "where the robot is, not a position"
            )
        columns.append(values)
        notes.append(note)
    said = tuple(f"{file}: {note}" for note in notes if note)
    return PathDeviation(file, tuple(axes), time_s - time_s[0], np.column_stack(columns), said)


def _column(table: Table, axis: str) -> str:
    wanted = (f"deviation_{axis}", axis)
    for each in wanted:
        found = [name for name in table if split_unit(name)[0] == each]
        if len(found) == 1:
            return found[0]
        if found:
            raise CheckFailed(f"{table.file}: {' and '.join(found)} are both the deviation of axis {axis}; leave one")
    name = f"deviation_{axis}_um"
    raise CheckFailed(f"{table.file}: there is no column {name}; {did_you_mean(name, table, 'its columns are')}")


def _in_unit(table: Table, name: str, dimension: str, base: str) -> tuple[Array, str]:
    """Values (n,) in `base`, and what to say of another unit."""
    unit = table.unit(name)
    if unit is None:
        plain = "t" if base == "s" else name
        raise CheckFailed(
            f"{table.file}: the column {name} states no unit; call it {plain}_{base}, or {plain} ({base})"
        )
    found = known(unit)
    if found is None or found.dimension != dimension:
        raise CheckFailed(f"{table.file}: the column {name} is in {unit}, which is no unit of {dimension}; give {base}")
    if found.factor == 1.0:
        return table[name], ""
    return table[name] * found.factor, f"{name} is in {unit}: taken times {found.factor:g}"


def _refuse_gaps(table: Table, name: str, values: Array) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise CheckFailed(f"{table.where(int(bad[0]))}: {name} has no number here")
