"""The catalogue: one SQLite file, which may be removed at any time: all that is in it is in the files themselves."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import stat
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Any

from micromanip.errors import CheckFailed, system_error

from .describing import Entry, described, may_be_ours

_LAYOUT = 1
_TABLES = """
CREATE TABLE folders (path TEXT PRIMARY KEY);
CREATE TABLE entries (
    path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, kind TEXT, began TEXT, about TEXT, seconds REAL,
    configuration TEXT, faults TEXT, rms_um TEXT, worst_um REAL, problem TEXT
);
CREATE INDEX began ON entries (began);
CREATE INDEX worst ON entries (worst_um);
"""
_COLUMNS = ("path", "kind", "began", "about", "seconds", "configuration", "faults", "rms_um", "problem")
_PATIENCE_S = 10.0
_EMPTY = (0, 0)
SORTS = {"newest": "began DESC", "oldest": "began", "worst": "worst_um DESC", "longest": "seconds DESC"}


@dataclass(frozen=True)
class Query:
    """What is looked for; None is anything. `since` and `until` are beginnings of ISO 8601, `above_um` an rms."""

    kind: str | None = None
    since: str | None = None
    until: str | None = None
    fault: str | None = None
    configuration: str | None = None
    text: str | None = None
    above_um: float | None = None
    sort: str = "newest"
    most: int = 50


class Catalogue:
    """The catalogue in `file`, made where there is none; raises CheckFailed where something else is there."""

    def __init__(self, file: Path) -> None:
        self._file = file
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(file, timeout=_PATIENCE_S)
            if (layout := self._layout()) == 0:
                layout = self._make()
            if layout != _LAYOUT:
                raise CheckFailed(f"{file}: of another version; remove it, it is made again by `micromanip runs`")
        except sqlite3.Error as problem:
            raise CheckFailed(
                f"{file}: {problem}; where it is no catalogue remove it, it is made again by `micromanip runs`"
            ) from problem
        except OSError as problem:
            raise system_error(problem, file) from problem

    def __enter__(self) -> Catalogue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def _layout(self) -> int:
        return int(self._connection.execute("PRAGMA user_version").fetchone()[0])

    def _make(self) -> int:
        """Tables in a file that has none; the layout then. Another process may have been faster."""
        with self._connection as base:
            base.execute("BEGIN IMMEDIATE")
            if self._layout() == 0 and not base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                for statement in _TABLES.split(";"):
                    base.execute(statement)
                base.execute(f"PRAGMA user_version = {_LAYOUT}")
            return self._layout()

    def folders(self) -> list[Path]:
        """Those that are looked through."""
        return [Path(path) for (path,) in self._all("SELECT path FROM folders ORDER BY path")]

    def add(self, folder: Path) -> None:
        """Look through `folder` from now on."""
        self._change("INSERT OR IGNORE INTO folders VALUES (?)", str(folder.resolve()))

    def drop(self, folder: Path) -> bool:
        """Look through it no more, and forget what was in it; whether it was looked through."""
        known = folder.resolve() in self.folders()
        self._change("DELETE FROM folders WHERE path = ?", str(folder.resolve()))
        for (path,) in self._all("SELECT path FROM entries"):
            if Path(path).is_relative_to(folder.resolve()):
                self._change("DELETE FROM entries WHERE path = ?", path)
        return known

    def refresh(self, folders: Sequence[Path], tell: Callable[[Path], None] = lambda _: None) -> None:
        """Take in what is new or changed in `folders`, and forget what is gone; `tell` hears of each file that is read.

        A file that can't be read is kept with the reason.
        """
        known = {path: (size, at) for path, size, at in self._all("SELECT path, size, mtime_ns FROM entries")}
        seen = set()
        for path, size, mtime_ns in _files(folders):
            seen.add(str(path))
            if known.get(str(path), _EMPTY) != (size, mtime_ns):
                tell(path)
                self._keep(path, size, mtime_ns)
        inside = [folder.resolve() for folder in folders]
        for gone in known.keys() - seen:
            if any(Path(gone).is_relative_to(folder) for folder in inside):
                self._change("DELETE FROM entries WHERE path = ?", gone)

    def find(self, query: Query) -> list[Entry]:
        """Entries that match all of `query`."""
        conditions, values = _conditions(query)
        where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
        select = f"SELECT {', '.join(_COLUMNS)} FROM entries {where} ORDER BY {SORTS[query.sort]}, path LIMIT ?"
        return [_entry(row) for row in self._all(select, *values, query.most)]

    def count(self) -> int:
        """All entries."""
        return int(next(self._all("SELECT count(*) FROM entries WHERE kind != ''"))[0])

    def _keep(self, path: Path, size: int, mtime_ns: int) -> None:
        try:
            entry = described(path)
        except OSError as problem:
            entry = Entry(path, "", "", "", problem=problem.strerror or str(problem))
        entry = entry or Entry(path, "", "", "")  # none of ours: remembered, so that it is not read again
        row = {name.name: getattr(entry, name.name) for name in fields(Entry)}
        row |= {"path": str(path), "faults": " ".join(entry.faults), "rms_um": json.dumps(dict(entry.rms_um))}
        row |= {"size": size, "mtime_ns": mtime_ns, "worst_um": max(entry.rms_um.values(), default=None)}
        places = ", ".join(f":{name}" for name in row)
        self._change(f"INSERT OR REPLACE INTO entries ({', '.join(row)}) VALUES ({places})", **row)

    def _all(self, statement: str, *values: Any) -> Iterator[Any]:
        with self._told():
            yield from self._connection.execute(statement, values).fetchall()

    def _change(self, statement: str, *values: Any, **named: Any) -> None:
        with self._told(), self._connection:
            self._connection.execute(statement, named or values)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as problem:
            raise CheckFailed(f"{self._file}: {problem}") from problem


def _conditions(query: Query) -> tuple[list[str], list[Any]]:
    found: list[tuple[str, Any]] = []
    for condition, value in (
        ("kind = ?", query.kind),
        ("began >= ?", query.since),
        ("substr(began, 1, length(?)) <= ?", query.until),
        ("' ' || faults || ' ' LIKE ?", query.fault and f"% {query.fault} %"),
        ("configuration LIKE ?", query.configuration and f"%{query.configuration}%"),
        ("(path || about || problem) LIKE ?", query.text and f"%{query.text}%"),
        ("worst_um > ?", query.above_um),
    ):
        if value is not None:
            found += [(condition, value)]
    values = [value for condition, value in found for _ in range(condition.count("?"))]
    return ["kind != ''", *(condition for condition, _ in found)], values


def _entry(row: Sequence[Any]) -> Entry:
    told = dict(zip(_COLUMNS, row, strict=True))
    faults, rms_um = tuple(told.pop("faults").split()), json.loads(told.pop("rms_um"))
    return Entry(Path(told.pop("path")), **told, faults=faults, rms_um=rms_um)


def _files(folders: Sequence[Path]) -> Iterator[tuple[Path, int, int]]:
    """Each file once, with size and time of its last change; what is hidden, or a link, is passed over."""
    for folder in dict.fromkeys(folder.resolve() for folder in folders):
        for place, below, names in os.walk(folder):
            below[:] = sorted(
                name for name in below if not name.startswith(".") and not (Path(place) / name).is_symlink()
            )
            for path in (Path(place, name) for name in sorted(names) if not name.startswith(".")):
                with contextlib.suppress(OSError):
                    found = path.lstat()
                    if may_be_ours(path) and stat.S_ISREG(found.st_mode):
                        yield path, found.st_size, found.st_mtime_ns
