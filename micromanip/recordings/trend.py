"""Trends of months: one CSV file per day with one row per second, another per minute: docs/recording.md.

``2026-11-23-minutes.csv``; a number behind it, ``-2``, where the columns changed during the day. ``time`` is when a row
begins, UTC. A row has been written whole if it ends with its newline: what follows the last one is none.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, UsageError, did_you_mean
from micromanip.files import open_regular

from .table import Array

SECOND, MINUTE = "second", "minute"
STEP_S = {SECOND: 1, MINUTE: 60}
TIME = "time"
STATISTICS = ("min", "mean", "max", "rms")
COUNTED = ("seconds", "cycles", "overruns", "link_down_cycles")
"""Columns that add up: the time that the rows cover, cycles, deadlines missed, cycles with a link down."""
STATE, FAULT = "state", "fault"
"""The last of the row; the last fault that was latched in it, 0 for none. Numbers of ``micromanip.rt.states``."""
_NAME = re.compile(r"(\d{4}-\d\d-\d\d)-(second|minute)s(?:-\d+)?\.csv")
_GAP_STEPS = 1.5


@dataclass(frozen=True)
class DayFile:
    """What a file's name says."""

    path: Path
    day: str
    every: str


def file_name(day: str, every: str, number: int = 1) -> str:
    """Of the trend of a day, ``2026-11-23``."""
    return f"{day}-{every}s.csv" if number == 1 else f"{day}-{every}s-{number}.csv"


def day_file(path: Path) -> DayFile | None:
    """None for a file that is called otherwise."""
    found = _NAME.fullmatch(path.name)
    return None if found is None else DayFile(path, found[1], found[2])


@dataclass(frozen=True)
class Trend:
    """Rows in the order of their time (n) UTC, `columns` (n) by their names, NaN where one was not known."""

    every: str
    time: NDArray[np.datetime64]
    columns: Mapping[str, Array]

    def gaps(self) -> list[tuple[np.datetime64, np.datetime64]]:
        """Ends and beginnings of the rows between which there are none: no controller ran."""
        step = np.timedelta64(STEP_S[self.every], "s")
        apart = np.flatnonzero(np.diff(self.time) > _GAP_STEPS * STEP_S[self.every] * np.timedelta64(1, "s"))
        return [(self.time[k] + step, self.time[k + 1]) for k in apart]


def read_trend(
    place: Path,
    every: str | None = None,
    since: np.datetime64 | None = None,
    until: np.datetime64 | None = None,
    fields: Sequence[str] = (),
) -> Trend:
    """The rows of a file or of the files in a folder that begin between `since` and `until`.

    `fields` are names of columns, or what they begin with up to an underscore; none stand for all. `every` is taken
    from the name of a file; of a folder minutes are read by default. Raises CheckFailed for what can't be read, or
    where there is no row, UsageError for a field that no file has.
    """
    files, every = _files(place, every, since, until)
    parts = [_read(each.path, [*fields, *COUNTED, STATE, FAULT] if fields else ()) for each in files]
    names = list(dict.fromkeys(name for part in parts for name in part if name != TIME))
    _require_fields(place, fields, names, files)
    time = np.concatenate([part[TIME] for part in parts]) if parts else np.zeros(0, "datetime64[s]")
    chosen = np.ones(len(time), bool)
    if since is not None:
        chosen &= time >= since
    if until is not None:
        chosen &= time < until
    if not chosen.any():
        raise CheckFailed(f"{place}: no {every} of a trend in it at that time")
    order = np.argsort(time[chosen], kind="stable")
    columns = {}
    for name in names:
        of_all = [part.get(name, np.full(len(part[TIME]), np.nan)) for part in parts]
        columns[name] = np.concatenate(of_all)[chosen][order]
    return Trend(every, time[chosen][order], columns)


def matching(names: Sequence[str], field: str) -> list[str]:
    """Columns that `field` means."""
    return [name for name in names if name == field or name.startswith(f"{field}_")]


def _files(
    place: Path, every: str | None, since: np.datetime64 | None, until: np.datetime64 | None
) -> tuple[list[DayFile], str]:
    if not place.is_dir():
        found = day_file(place)
        if found is None:
            raise CheckFailed(f"{place}: no trend: a folder is, or a file called {file_name('2026-11-23', MINUTE)}")
        if every not in (None, found.every):
            raise UsageError(f"{place}: it has one row per {found.every}, not per {every}")
        return [found], found.every
    every = every or MINUTE
    try:
        known = [found for path in sorted(place.iterdir()) if (found := day_file(path)) and found.every == every]
    except OSError as problem:
        raise CheckFailed(f"{place}: can't be read: {problem.strerror}") from problem
    if not known:
        raise CheckFailed(f"{place}: no trend in it, no file called {file_name('2026-11-23', every)}")
    first = "" if since is None else str(since)[:10]
    last = "9" if until is None else str(until)[:10]
    return [each for each in known if first <= each.day <= last], every


def _require_fields(place: Path, fields: Sequence[str], names: Sequence[str], files: Sequence[DayFile]) -> None:
    for field in fields if files else ():
        if not matching(names, field):
            known = _head(files[-1].path)[1:]
            raise UsageError(f"{place}: there is no column {field}; {did_you_mean(field, known, 'its columns are')}")


def _head(path: Path) -> list[str]:
    with open_regular(path) as stream:
        return stream.readline(1 << 20).decode("utf-8", "replace").strip().split(",")


def _read(path: Path, fields: Sequence[str]) -> dict[str, NDArray[np.generic]]:
    """`TIME` and the columns that `fields` mean; a row that was cut off is left out."""
    try:
        with open_regular(path) as stream:
            content = stream.read()
    except OSError as problem:
        raise CheckFailed(f"{path}: can't be read: {problem.strerror}") from problem
    whole = content[: content.rfind(b"\n") + 1]
    head = whole.partition(b"\n")[0].decode("utf-8", "replace").split(",")
    if head[0] != TIME:
        if not whole:
            return {TIME: np.zeros(0, "datetime64[s]")}  # its writer was killed before the first row
        raise CheckFailed(f"{path}:1: no trend of ours: its first column is {head[0]!r:.40}, not {TIME!r}")
    missing = {*COUNTED, STATE, FAULT} - {*head}
    if missing:
        raise CheckFailed(f"{path}:1: no whole trend: it has no column {min(missing)}")
    wanted = [k for k, name in enumerate(head) if k and (not fields or any(matching([name], each) for each in fields))]
    kinds = np.dtype([(TIME, "U19"), *((head[k], "f8") for k in wanted)])
    try:
        if whole.count(b"\n") < 2:
            rows = np.zeros(0, kinds)
        else:
            text = io.StringIO(whole.decode("utf-8"))
            rows = np.loadtxt(text, kinds, delimiter=",", skiprows=1, usecols=[0, *wanted], ndmin=1, comments=None)
        return {TIME: rows[TIME].astype("datetime64[s]"), **{head[k]: rows[head[k]] for k in wanted}}
    except (ValueError, IndexError) as problem:
        raise CheckFailed(f"{path}{_first_bad(whole, len(head)) or f': {problem}'}") from problem


def _first_bad(content: bytes, width: int) -> str:
    """Number of the first line that is no row, and why; nothing where all seem good."""
    for number, line in enumerate(content.splitlines()[1:], 2):
        values = line.split(b",")
        if len(values) != width:
            return f":{number}: this row has {len(values)} values, the head {width}; remove that line"
        try:
            np.datetime64(values[0].decode("ascii"), "s")
            [float(value) for value in values[1:]]
        except ValueError as problem:
            return f":{number}: {problem}; remove that line"
    return ""
