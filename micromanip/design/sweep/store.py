"""Results of a sweep in a SQLite file: a row per tuning, by its number. What is there need not be computed again."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError

from .work import Tried

_FORMAT = 1
_FIGURES = ("rms_um", "p99_um", "peak_um")


class Store:
    """The file; it belongs to one sweep, told by `about`: the same recordings, tuning, ranges and seed."""

    def __init__(self, file: Path, about: dict[str, Any], keys: Sequence[str], axes: Sequence[str]) -> None:
        """Raises UsageError for a file that is of another sweep, or none of ours; DeviceUnavailable by the disk."""
        self.file, self._keys, self._axes = file, list(keys), list(axes)
        self._figures = [f"{name}_{axis}" for name in _FIGURES for axis in axes]
        told = json.dumps({"format": _FORMAT, **about}, sort_keys=True)
        try:
            self._database = sqlite3.connect(file)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("CREATE TABLE IF NOT EXISTS sweep (about TEXT NOT NULL)")
            found = self._database.execute("SELECT about FROM sweep").fetchone()
            if found is None:
                self._create(told)
        except sqlite3.DatabaseError as problem:
            raise _refused(file, problem) from problem
        if found is not None and found[0] != told:
            was, is_ = json.loads(found[0]), json.loads(told)
            other = next(key for key in {**was, **is_} if was.get(key) != is_.get(key))
            self._database.close()
            raise UsageError(
                f"{file} holds another sweep: its {other} is {was.get(other)!s:.80}, not {is_.get(other)!s:.80}; give "
                "another name"
            )

    def _create(self, told: str) -> None:
        columns = [*self._keys, *self._figures]
        named = ", ".join(f"{_quoted(name)} REAL" for name in columns)
        self._database.execute(
            f"CREATE TABLE tunings (number INTEGER PRIMARY KEY, cost_um REAL, stopped INTEGER, problem TEXT, {named})"
        )
        self._database.execute("INSERT INTO sweep VALUES (?)", (told,))
        self._database.commit()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.close()

    def missing(self, number: int) -> list[int]:
        """Those of the tunings 0 .. `number` that are not there."""
        there = {row[0] for row in self._database.execute("SELECT number FROM tunings")}
        return [each for each in range(number + 1) if each not in there]

    def add(self, tried: Iterable[Tried]) -> None:
        """Keep results, at once and all together; raises DeviceUnavailable where the disk refuses them."""
        rows = []
        for each in tried:
            values = [each.values.get(key) for key in self._keys]
            figures = [um for name in _FIGURES for um in getattr(each, name)] or [None] * len(self._figures)
            rows.append((each.number, each.cost_um, each.stopped, each.problem, *values, *figures))
        places = ", ".join("?" * (4 + len(self._keys) + len(self._figures)))
        try:
            with self._database:
                self._database.executemany(f"INSERT OR REPLACE INTO tunings VALUES ({places})", rows)
        except sqlite3.DatabaseError as problem:
            raise _refused(self.file, problem) from problem

    def best(self, count: int) -> list[Tried]:
        """The tunings with the least error, the best first."""
        found = self._database.execute(
            "SELECT * FROM tunings WHERE cost_um IS NOT NULL ORDER BY cost_um, number LIMIT ?", (count,)
        )
        return [self._read(row) for row in found]

    def one(self, number: int) -> Tried:
        """Tuning `number`."""
        return self._read(self._database.execute("SELECT * FROM tunings WHERE number = ?", (number,)).fetchone())

    def write_table(self, file: Path) -> None:
        """All rows, by number: CSV, or Parquet by the ending. CheckFailed without the extra for that."""
        found = self._database.execute("SELECT * FROM tunings ORDER BY number")
        names, rows = [each[0] for each in found.description], found.fetchall()
        if file.suffix.lower() == ".parquet":
            try:
                import pyarrow
                from pyarrow import parquet
            except ImportError as problem:
                raise CheckFailed(f"{file}: Parquet needs the extra: pip install micromanip[parquet]") from problem
            columns = zip(*rows, strict=True)
            kinds = {"number": pyarrow.int64(), "stopped": pyarrow.int64(), "problem": pyarrow.string()}
            arrays = [
                pyarrow.array(column, kinds.get(name, pyarrow.float64()))
                for name, column in zip(names, columns, strict=True)
            ]
            parquet.write_table(pyarrow.table(arrays, names), file)
            return
        with file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(names)
            writer.writerows(rows)

    def counts(self) -> dict[str, int]:
        """How many were tried, of those how many are refused and how many stop."""
        names = "count(*), coalesce(sum(problem != ''), 0), coalesce(sum(stopped > 0), 0)"
        found = self._database.execute(f"SELECT {names} FROM tunings").fetchone()
        return dict(zip(("tried", "refused", "stopped"), found, strict=True))

    def _read(self, row: Sequence[Any]) -> Tried:
        number, cost_um, stopped, problem, *rest = row
        values = {key: value for key, value in zip(self._keys, rest, strict=False) if value is not None}
        if cost_um is None:
            return Tried(number, values, stopped=stopped, problem=problem)
        figures, size = rest[len(self._keys) :], len(self._axes)
        rms, p99, peak = (tuple(figures[k * size : (k + 1) * size]) for k in range(len(_FIGURES)))
        return Tried(number, values, cost_um, rms, p99, peak)


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _refused(file: Path, problem: sqlite3.DatabaseError) -> Exception:
    if isinstance(problem, sqlite3.OperationalError):
        return DeviceUnavailable(f"{file}: {problem}; make room there, or choose another place")
    return UsageError(f"{file} is no file of a sweep: {problem}; give another name")
