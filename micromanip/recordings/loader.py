"""What a command takes of a recording: columns by name and unit, a part of the time, at a rate; and what it tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, UsageError

from .clock import Clock, even, read_clock, unwrapped
from .reading import read_table
from .rows import usable
from .spikes import faults_only, find_spikes
from .table import Array, Table, called_time, has_time_word
from .time_series import TimeSeries, resampled
from .units import known, known_time, unknown_unit

_MOST_SAMPLES = 20_000_000
LISTS = 0
NO_TIME = "none"
"""A name of a column of time that says: none is to be used."""
_LATEST_S = 1e11
"""Times beyond, some 3,000 years, are counted in parts of a second, as those since 1970 or since a computer's start."""
_DAYS, _DAY_S, _ROUND = ((2e4, 8e4), (6e5, 9e5)), 86_400.0, 1e-3
"""Days of our century from 1900 and from the year 0."""
_SAME_RATE, _GAP = 1e-9, 2.5
"""Share by which rates differ that are one; steps from which on there is a gap between jittered samples."""
_BASE = {"length": "um", "voltage": "V"}
_OTHER = {"length": "mm", "voltage": "mV"}


@dataclass(frozen=True)
class Wanted:
    """Which columns, ``NAME[:unit]``, and how much of them: `cut` in s from the first sample, `rate_hz` of the result.

    `step_s` is the sampling interval where there is no column of time, or none is to be used, `time` "none".
    `dimensions`, of each column where it is given ("voltage", "length"), is what is meant by one that states no unit.
    The first `inputs` columns drive the others; with LISTS there are two entries, names of inputs and of outputs with
    commas between them. Spikes are looked for where they are to be bridged (`bridge`): in these, only faults.
    """

    columns: Sequence[str]
    time: str | None = None
    step_s: float | None = None
    cut: tuple[float, float] | None = None
    rate_hz: float | None = None
    dimensions: Sequence[str | None] = ()
    inputs: int | None = None
    bridge: bool = True


def take(file: Path, wanted: Wanted) -> TimeSeries:
    """Read and judge what is `wanted` of `file`.

    Lengths come in um, voltages in V, times in s, whatever they were written in. Missing samples are left out, jittered
    ones are brought onto a grid. CheckFailed, with what would be right, for what can't be used.
    """
    table = read_table(file)
    lists = wanted.inputs == LISTS
    asked = [table.listed(columns) for columns in wanted.columns] if lists else [wanted.columns]
    inputs = len(asked[0]) if lists else wanted.inputs
    found = [table.resolve(column) for columns in asked for column in columns]
    names = tuple(name for name, _ in found)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"{file}: the column {twice} is named twice; an input can't be an output")
    columns = {name: table[name] for name in names}
    notes: list[str] = []
    timed = wanted.time or table.time_column(names)
    timed = None if timed == NO_TIME and NO_TIME not in table else timed
    time_name, t = _times(table, timed, wanted, notes)
    if t is not None and time_name is not None:
        columns = {time_name: t} | columns
    other, samples = next((name, len(values)) for name, values in columns.items())
    for name, values in columns.items():
        if len(values) != samples:
            raise CheckFailed(f"{file}: {name} has {len(values)} values, {other} {samples}: not one recording")
    stacked = np.column_stack([columns[name] for name in names])
    if t is not None and len(t) > 1 and np.all(np.diff(t) < 0.0):
        t, stacked, table.lines = t[::-1], stacked[::-1], table.lines and table.lines[::-1]
        notes.append(f"{time_name} falls with every row: the newest stands first, read from the last on")
    rows = usable(table, names, stacked, time_name, t, fill=wanted.rate_hz is not None, clean=wanted.bridge)
    if time_name is None:
        clock = even(rows.number, wanted.step_s or 1.0)
    else:
        any_rate = wanted.rate_hz is not None
        where = lambda row: table.where(int(rows.number[row]))  # noqa: E731
        clock = read_clock(time_name, rows.times, where, any_rate=any_rate, step_s=wanted.step_s)
    part = _part(file, clock, wanted.cut)
    dimensions = wanted.dimensions or [None] * len(names)
    written = [unit for _, unit in found]
    units, scaled = _in_our_units(file, names, written, dimensions, rows.values[part], notes)
    read = [*table.notes, *rows.left_out(rows.number[part], whole=wanted.cut is None), *clock.notes]
    notes[:0] = ["; ".join(read)] if read else []
    many = len(scaled) > 10 and wanted.bridge
    spikes = np.column_stack([find_spikes(column) for column in scaled.T]) if many else np.zeros(scaled.shape, bool)
    faults = spikes if inputs is None else faults_only(scaled, spikes, inputs)
    _tell_of_spikes(table, names, spikes, faults, rows.number[part], notes)
    series = TimeSeries(file, names, units, scaled, clock.step_s, clock.index[part], faults, inputs or 1)
    if clock.jittered:
        series = resampled(series, series.step_s, clock.seconds[part] / clock.step_s, _GAP)
    if wanted.rate_hz is not None and abs(series.step_s * wanted.rate_hz - 1.0) > _SAME_RATE:
        notes.append(f"resampled from {1 / series.step_s:.6g} to {wanted.rate_hz:.6g} Hz")
        series = resampled(series.bridged(), 1.0 / wanted.rate_hz)
    if len(series) > _MOST_SAMPLES:
        raise CheckFailed(
            f"{file}: {len(series)} samples are more than can be fitted to ({_MOST_SAMPLES}): "
            "take a part, --cut FROM:TO, or fewer, --resample HZ"
        )
    return replace(series, notes=tuple(notes), told=_told(series, table.place(time_name)))


def _told(series: TimeSeries, place: str) -> str:
    """What was taken, in a line."""
    named = zip(series.names, series.units, strict=True)
    columns = ", ".join(name if unit is None else f"{name} in {unit}" for name, unit in named)
    length = (int(series.index[-1]) + 1 - int(series.index[0])) * series.step_s
    return (
        f"{series.file.name} ({place}): {columns}; {len(series)} samples every {series.step_s:.6g} s "
        f"({1 / series.step_s:.6g} Hz), {length:.4g} s"
    )


def _times(table: Table, timed: str | None, wanted: Wanted, notes: list[str]) -> tuple[str | None, Array | None]:
    """Name and values, s, of the column of time; None where there is none and the interval is given."""
    if timed is None:
        if wanted.step_s is None:
            for name, text in table.texts.items():
                if called_time(name) and text:
                    raise CheckFailed(
                        f"{table.file}: {name} has {text[:40]!r}, which is no time known here: 2026-11-24 15:02:10.5, "
                        "2026-11-24T15:02:10+01:00 and 24.11.2026 15:02:10.5 are; or give --dt"
                    )
            raise CheckFailed(
                f"{table.file}: there is no time column (a name that begins with t); name it with --time, or give --dt"
            )
        return None, None
    name, unit = table.resolve(timed)
    stated = unit or unknown_unit(name) or (name if called_time(name) or has_time_word(name) else None)
    scale = known(unit) if unit else known_time(stated) if stated else None
    t = table[name]
    if scale is None:
        _require_seconds(table, name, unit or unknown_unit(name), t)
    if wanted.time is None:
        _require_one_clock(table, name, t)
    t, told = unwrapped(name, t, 1.0 if scale is None or scale.dimension != "time" else scale.factor, table.where)
    notes += told
    if scale is not None and scale.dimension == "count":
        if wanted.step_s is None:
            raise CheckFailed(f"{table.file}: {name} counts samples: give their interval, --dt")
        t = t * wanted.step_s
    elif scale is not None and scale.dimension == "time":
        t = t * scale.factor
    elif scale is not None:
        raise CheckFailed(f"{table.file}: {name} is in {unit}, which is no time; name the right column with --time")
    return name, t


def _require_seconds(table: Table, name: str, stated: str | None, t: Array) -> None:
    """CheckFailed for times without a unit known here that are none in s: the rate would be another."""
    if stated is not None:
        raise CheckFailed(
            f"{table.file}: {name}: {stated!r} is no unit of time known here; say which, "
            f"--time '{name}:s', or ms, us, ns"
        )
    latest = float(np.max(np.abs(t[np.isfinite(t)]), initial=0.0))
    step = float(np.median(np.abs(np.diff(t[np.isfinite(t)]))))
    if any(low < latest < high for low, high in _DAYS) and not _is_round(step) and _is_round(step * _DAY_S):
        raise CheckFailed(
            f"{table.where(0)}: {name} is {t[0]:.10g} and goes on by {step:.3g}: if these are days, as "
            f"spreadsheets and MATLAB count them, say --time '{name}:days', else '{name}:s'"
        )
    if latest > _LATEST_S:
        unit = "ms" if latest < 1e14 else "us" if latest < 1e17 else "ns"
        raise CheckFailed(
            f"{table.where(0)}: {name} is {t[0]:.6g}, which can't be in s; say its unit, --time {name}:{unit}"
        )


def _is_round(interval: float) -> bool:
    """Whether an interval, or its rate, has two digits only."""
    return interval > 0.0 and any(abs(x / float(f"{x:.2g}") - 1.0) < _ROUND for x in (interval, 1.0 / interval))


def _require_one_clock(table: Table, name: str, t: Array) -> None:
    """CheckFailed where a column of the same name has other times: each signal may have its own."""
    for other in table:
        if (
            other.rpartition(".")[0] == name
            and other.rpartition(".")[2].isdigit()
            and not np.array_equal(table[other], t)
        ):
            raise CheckFailed(
                f"{table.file}: {name} and {other} have different times: say which are those of the columns, "
                f"--time {name} or --time {other}"
            )


def _part(file: Path, clock: Clock, cut: tuple[float, float] | None) -> slice:
    if cut is None:
        return slice(0, len(clock.index))
    first, last = (int(np.searchsorted(clock.seconds, edge - 1e-9 * clock.step_s)) for edge in cut)
    if last - first < 2:
        raise CheckFailed(
            f"{file}: --cut {cut[0]:g}:{cut[1]:g} leaves {max(last - first, 0)} samples: "
            f"the recording goes from 0 to {clock.seconds[-1]:.6g} s"
        )
    return slice(first, last)


def _in_our_units(
    file: Path,
    names: Sequence[str],
    written: Sequence[str | None],
    meant: Sequence[str | None],
    values: Array,
    notes: list[str],
) -> tuple[tuple[str | None, ...], Array]:
    units: list[str | None] = []
    scaled = values.copy()
    for k, (name, unit, dimension) in enumerate(zip(names, written, meant, strict=True)):
        scale = known(unit) if unit else None
        units.append(scale.base if scale else None)
        if scale is None:
            if dimension is not None:
                strange = unit or unknown_unit(name)
                says = f"{name}: {strange!r} is no unit known here" if strange else f"{name} states no unit"
                notes.append(f"{says}: taken as {_BASE[dimension]}; {name}:{_OTHER[dimension]} says another")
            continue
        if dimension not in (None, scale.dimension):
            raise CheckFailed(
                f"{file}: {name} is in {unit}, which is no unit of {dimension}; name the right column, or write its "
                f"unit behind it, {name}:{_BASE[dimension or '']}"
            )
        if scale.factor != 1.0:
            scaled[:, k] *= scale.factor
            notes.append(f"{name}: {unit} turned into {scale.base}")
    return tuple(units), scaled


def _tell_of_spikes(
    table: Table,
    names: Sequence[str],
    spikes: NDArray[np.bool_],
    faults: NDArray[np.bool_],
    rows: NDArray[np.int64],
    notes: list[str],
) -> None:
    for name, flags, fault in zip(names, spikes.T, faults.T, strict=True):
        for which, done in (
            (fault, "bridged, and not fitted to (--keep-spikes fits them)"),
            (flags & ~fault, "kept, as input and output agree"),
        ):
            at = np.flatnonzero(which)
            if len(at):
                many = f"{len(at)} samples stand out as spikes, the first" if len(at) > 1 else "a spike"
                notes.append(f"{name}: {many} at {table.where(int(rows[at[0]]))}: {done}")
