"""The audit trail: who asked for what, when, from what to what, and whether it was done.

JSON lines in ``audit.jsonl`` of the state directory. It never stops a verb: what can't be written is counted.
"""

from __future__ import annotations

import asyncio
import json
import os
import threading
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from micromanip.answers import Audit, AuditEntry, Change
from micromanip.errors import MicromanipError

from .peer import Peer

_NAME = "audit.jsonl"
_MAX_BYTES = 10_000_000

Result = TypeVar("Result")


class AuditTrail:
    """Appends to the trail in `folder`; one older file is kept, so that it takes at most twice `max_bytes`."""

    def __init__(self, folder: Path, say: Callable[[str], None], max_bytes: int = _MAX_BYTES) -> None:
        """`say` gets a warning, once, where the trail can't be written."""
        self.file = folder / _NAME
        self.unwritten = 0
        self._say, self._max_bytes = say, max_bytes
        self._missing = 0
        self._writing = threading.Lock()

    async def note(self, peer: Peer, verb: str, changes: Sequence[Change] = (), reason: str | None = None) -> None:
        """Add an entry; a `reason` is why it was refused. Never raises."""
        entry = AuditEntry(
            time=datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            user=peer.user,
            uid=peer.uid,
            pid=peer.pid,
            verb=verb,
            accepted=reason is None,
            reason=reason,
            changes=list(changes),
            missing_before=0,
        )
        if problem := await asyncio.to_thread(self._append, entry):
            if not self.unwritten:
                self._say(f"WARNING: the audit trail {self.file} can't be written: {problem}. What is not is counted.")
            self.unwritten += 1

    async def follow(
        self,
        peer: Peer,
        verb: str,
        asked: Sequence[Change],
        change: Callable[[], Awaitable[tuple[Result, Sequence[Change]]]],
    ) -> Result:
        """Result of `change`; the trail gets what it changed, or what was `asked` and why it was refused."""
        try:
            result, changes = await change()
        except MicromanipError as refusal:
            await self.note(peer, verb, asked, str(refusal))
            raise
        await self.note(peer, verb, changes)
        return result

    def last(self, count: int) -> Audit:
        """The newest `count` entries; what is not a line of ours is passed over."""
        entries: deque[AuditEntry] = deque(maxlen=count)
        for file in (self._older, self.file):
            entries.extend(_entries(file))
        return Audit(file=str(self.file), unwritten=self.unwritten, entries=list(entries))

    @property
    def _older(self) -> Path:
        return self.file.with_name(f"{_NAME}.1")

    def _append(self, entry: AuditEntry) -> str | None:
        """Write one line; what went wrong, or None."""
        with self._writing:
            entry["missing_before"] = self._missing
            try:
                self.file.parent.mkdir(parents=True, exist_ok=True)
                if self.file.exists() and self.file.stat().st_size >= self._max_bytes:
                    self.file.replace(self._older)
                _write_line(self.file, json.dumps(entry))
            except OSError as problem:
                self._missing += 1
                return problem.strerror or str(problem)
            self._missing = 0
            return None


def _write_line(file: Path, line: str) -> None:
    descriptor = os.open(file, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o640)
    try:
        size = os.fstat(descriptor).st_size
        torn = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"  # by a disk that was full
        content = (b"\n" if torn else b"") + line.encode() + b"\n"
        if os.write(descriptor, content) != len(content):
            raise OSError("the disk is full")
    finally:
        os.close(descriptor)


def _entries(file: Path) -> Iterator[AuditEntry]:
    try:
        with file.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                entry = _entry(line)
                if entry is not None:
                    yield entry
    except OSError:
        return


def _entry(line: str) -> Any:
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) and entry.keys() == AuditEntry.__annotations__.keys() else None
