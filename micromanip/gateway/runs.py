"""Recordings, trips, reports and tunings on a page: what the catalogue has of them, and reports to open.

Files are read, and reports made, by processes of their own at low priority. A report is opened by an address, in
which a token must not be; so it has a ticket instead, a random number that is good for this one report, for a minute.
"""

from __future__ import annotations

import asyncio
import secrets
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from micromanip.catalogue import FILE
from micromanip.catalogue.describing import Entry
from micromanip.catalogue.store import SORTS, Catalogue, Query
from micromanip.errors import CheckFailed, UsageError, system_error

from .views import number

KINDS = ("recording", "trip", "trend", "report", "tuning")
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Of a report: it loads nothing, and runs no script."""
_AGAIN_S, _TICKET_S = 10.0, 60.0
_MOST, _MOST_TICKETS, _LONGEST = 500, 8, 1000


class Runs:
    """What is known of files in `folders`, and in those that `micromanip runs` looks through."""

    def __init__(self, state: Path, folders: Sequence[Path]) -> None:
        """`state` is the state directory: the catalogue is there, and it is looked through, too."""
        self._file, self._given = state / FILE, [state, *folders]
        self._refreshing: asyncio.Task[None] | None = None
        self._refreshed_s = float("-inf")
        self._problem: str | None = None
        self._tickets: dict[str, tuple[bytes, float]] = {}
        self._making = asyncio.Lock()

    async def find(self, told: dict[str, Any]) -> dict[str, Any]:
        """Entries that match what is `told`, as `Query` has it; UsageError where that makes no sense."""
        query = _query(told)
        if self._refreshing is None and time.monotonic() - self._refreshed_s >= _AGAIN_S:
            self._refreshing = asyncio.create_task(self._refresh())
        folders, count, found = await asyncio.to_thread(self._found, query)
        return {
            "folders": [str(folder) for folder in folders],
            "entries": count,
            "found": [{**asdict(entry), "path": str(entry.path)} for entry in found],
            "refreshing": self._refreshing is not None,
            "problem": self._problem,
        }

    async def report(self, told: dict[str, Any]) -> str:
        """A ticket for the report of a file of the catalogue; of a recording one is made, which takes some seconds.

        UsageError for another file, CheckFailed where none can be made.
        """
        path = told.get("path")
        entry = await asyncio.to_thread(self._entry, path) if isinstance(path, str) else None
        if entry is None or entry.kind not in ("report", "recording"):
            raise UsageError("a report is there of recordings and reports that the catalogue has")
        if entry.kind == "report":
            try:
                page = await asyncio.to_thread(entry.path.read_bytes)
            except OSError as problem:
                raise system_error(problem, entry.path) from problem
        else:
            async with self._making:
                page = await _ran("reporting", entry.path)
        now_s = time.monotonic()
        kept = [(ticket, held) for ticket, held in self._tickets.items() if held[1] > now_s]
        ticket = secrets.token_urlsafe(24)
        self._tickets = dict(kept[-_MOST_TICKETS + 1 :]) | {ticket: (page, now_s + _TICKET_S)}
        return ticket

    def page(self, ticket: str) -> bytes | None:
        """The report that this is the ticket of; None where it is good for nothing, or no more."""
        page, until_s = self._tickets.get(ticket, (None, 0.0))
        return page if until_s > time.monotonic() else None

    async def _refresh(self) -> None:
        try:
            folders = await asyncio.to_thread(self._folders)
            await _ran("refreshing", self._file, *folders)
            self._problem = None
        except (CheckFailed, OSError) as problem:
            self._problem = str(problem)
        finally:
            self._refreshing, self._refreshed_s = None, time.monotonic()

    def _folders(self) -> list[Path]:
        with Catalogue(self._file) as catalogue:
            return [*self._given, *catalogue.folders()]

    def _found(self, query: Query) -> tuple[list[Path], int, list[Entry]]:
        with Catalogue(self._file) as catalogue:
            return [*self._given, *catalogue.folders()], catalogue.count(), catalogue.find(query)

    def _entry(self, path: str) -> Entry | None:
        with Catalogue(self._file) as catalogue:
            return next((entry for entry in catalogue.find(Query(text=path)) if str(entry.path) == path), None)


def _command(module: str) -> list[str]:
    return [sys.executable, "-m", f"micromanip.catalogue.{module}"]


async def _ran(module: str, *arguments: Path) -> bytes:
    """What a module of the catalogue prints; CheckFailed with what it says where it fails."""
    running = await asyncio.create_subprocess_exec(
        *_command(module),
        *map(str, arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        printed, said = await running.communicate()
    finally:
        if running.returncode is None:
            running.kill()
            await running.wait()
    if running.returncode:
        lines = said.decode(errors="replace").splitlines()
        raise CheckFailed(lines[-1] if lines else f"{module} ended with {running.returncode}")
    return printed


def _query(told: dict[str, Any]) -> Query:
    if unknown := set(told) - {field.name for field in fields(Query)}:
        raise UsageError(f"a question has no {min(unknown)!r:.40}")
    texts = {name: told.get(name) for name in ("kind", "since", "until", "fault", "configuration", "text")}
    for name, text in texts.items():
        if text is not None and (not isinstance(text, str) or len(text) > _LONGEST):
            raise UsageError(f"{name} is a text of at most {_LONGEST} characters, or null")
    sort = told.get("sort", "newest")
    if sort not in SORTS or texts["kind"] not in (None, *KINDS):
        raise UsageError(f"sort is one of {', '.join(SORTS)}; kind is one of {', '.join(KINDS)}, or null")
    above_um = None if told.get("above_um") is None else number(told, "above_um", 0.0, 1e9)
    return Query(**texts, above_um=above_um, sort=sort, most=round(number({"most": 100} | told, "most", 1, _MOST)))
