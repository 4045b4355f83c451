"""The audit trail: who asked for what, when, from what to what, and whether it was done.

JSON lines in the state directory. It never stops a verb: what can't be written is counted. Of refusals that come again
and again the first is told, the others of the next minute are counted: so a client that asks for the impossible a
thousand times a second neither fills the disk nor hides what others do.

``audit.jsonl`` is today's file; a day that is over, or a part of it that has grown large, becomes
``audit-DATE.N.jsonl``. Where all together are too large, days that are over for long go first, then the day with most
bytes loses its oldest part: a burst pushes out itself, not what was there before.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

from micromanip.replies import Audit, AuditEntry, Change

from .authority import Peer

_VALUE_CHARS, _REFUSED_CHARS, _REASON_CHARS, _NAME_CHARS = 1000, 100, 2000, 200
"""A value, one that was refused, a reason, and a name or key are cut to this length; what was cut is said."""
_REFUSED_CHANGES = 20
_LOOK_S = 5.0
_WINDOW_S = 60.0
_DISTINCT = 10
_Key = tuple[str, int | None, str | None, str | None]


@dataclass
class _Seen:
    until: float
    newest: AuditEntry
    count: int = 0


class Repeats:
    """What was refused within the last minute; a user has so many `distinct` refusals, more are counted together."""

    def __init__(
        self, window_s: float = _WINDOW_S, distinct: int = _DISTINCT, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._window_s, self._distinct, self._clock = window_s, distinct, clock
        self._seen: dict[_Key, _Seen] = {}

    def is_counted(self, entry: AuditEntry) -> bool:
        """Take note of a refusal; True where it is counted with others and needs no line of its own."""
        user: tuple[str, int | None] = (entry["user"], entry["uid"])
        key: _Key = (*user, entry["verb"], entry["reason"])
        is_new = key not in self._seen
        if is_new and Counter(known[:2] for known in self._seen)[user] >= self._distinct:
            key = (*user, None, None)
        seen = self._seen.setdefault(key, _Seen(self._clock() + self._window_s, entry))
        if is_new and key[2] is not None:
            return False
        seen.newest, seen.count = entry, seen.count + 1
        return True

    def over(self, *, now: bool = False) -> list[AuditEntry]:
        """The newest of those whose minute is over (all of them: `now`), each with how many were counted."""
        ended = [key for key, seen in self._seen.items() if now or seen.until <= self._clock()]
        found = [self._seen.pop(key) for key in ended]
        return [AuditEntry(**{**seen.newest, "repeated": seen.count}) for seen in found if seen.count]


_NAME = "audit.jsonl"
_OLDER = re.compile(r"audit-(?P<day>\d{4}-\d\d-\d\d)\.(?P<part>\d+)\.jsonl")


@dataclass(frozen=True)
class Keeping:
    """How much is kept."""

    most_bytes: int = 100_000_000
    part_bytes: int = 5_000_000
    days: int = 90
    """They are kept longer where there is room, and shorter only where they are themselves too large."""


KEEPING = Keeping()


@dataclass(frozen=True, order=True)
class _Part:
    day: date
    number: int
    file: Path
    size: int


class AuditFiles:
    """The files in one folder: one per day, synchronised line by line, bounded in all."""

    def __init__(
        self, folder: Path, keeping: Keeping = KEEPING, now: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        self.file = folder / _NAME
        self._keeping, self._now = keeping, now

    def append(self, line: str) -> None:
        """Write one line, on the disk when this returns; raises OSError."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        if self._is_full():
            self._put_aside()
            self._make_room()
        _write_line(self.file, line)

    def newest_first(self) -> Iterator[Path]:
        """Every file, that of today first."""
        yield self.file
        yield from (part.file for part in reversed(self._parts()))

    def _day(self, file: Path) -> date:
        """The day of its newest line."""
        return datetime.fromtimestamp(file.lstat().st_mtime, UTC).date()

    def _is_full(self) -> bool:
        try:
            size = self.file.lstat().st_size
        except FileNotFoundError:
            return False
        return size >= self._keeping.part_bytes or (size > 0 and self._day(self.file) != self._now().date())

    def _put_aside(self) -> None:
        day = self._day(self.file)
        number = 1 + max((part.number for part in self._parts() if part.day == day), default=0)
        self.file.rename(self.file.with_name(f"audit-{day}.{number}.jsonl"))

    def _parts(self) -> list[_Part]:
        """All but today's, oldest first."""
        there = self.file.parent.iterdir() if self.file.parent.is_dir() else ()
        return sorted(
            _Part(date.fromisoformat(match["day"]), int(match["part"]), file, file.lstat().st_size)
            for file in there
            if (match := _OLDER.fullmatch(file.name))
        )

    def _make_room(self) -> None:
        parts = self._parts()
        long_ago = self._now().date() - timedelta(days=self._keeping.days)
        while sum(part.size for part in parts) > self._keeping.most_bytes - self._keeping.part_bytes:
            victim = parts[0]
            if victim.day >= long_ago:
                days: Counter[date] = Counter()
                for part in parts:
                    days[part.day] += part.size
                heaviest = days.most_common(1)[0][0]
                victim = next(part for part in parts if part.day == heaviest)
            victim.file.unlink(missing_ok=True)
            parts.remove(victim)


def _write_line(file: Path, line: str) -> None:
    is_new = not file.exists()
    descriptor = os.open(file, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o640)
    try:
        size = os.fstat(descriptor).st_size
        torn = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"  # by a disk that was full
        content = (b"\n" if torn else b"") + line.encode() + b"\n"
        if os.write(descriptor, content) != len(content):
            raise OSError("the disk is full")
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    if is_new:
        folder = os.open(file.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class AuditTrail:
    """The trail in `folder`."""

    def __init__(self, folder: Path, say: Callable[[str], None], keeping: Keeping = KEEPING) -> None:
        """`say` gets a warning, once, where the trail can't be written."""
        self._files = AuditFiles(folder, keeping)
        self.file = self._files.file
        self.unwritten = 0
        self._say = say
        self._missing = 0
        self._repeats = Repeats()
        self._writing = threading.Lock()

    async def note(self, peer: Peer, verb: str, changes: Sequence[Change] = (), reason: str | None = None) -> None:
        """Add an entry; a `reason` is why it was refused. Never raises."""
        entry = AuditEntry(
            time=_now(),
            user=peer.user,
            uid=peer.uid,
            pid=peer.pid,
            verb=_cut(verb, _NAME_CHARS),
            accepted=reason is None,
            reason=None if reason is None else _cut(reason, _REASON_CHARS),
            changes=_brief(changes) if reason is None else _refused(changes),
            missing_before=0,
        )
        if reason is None or not self._repeats.is_counted(entry):
            await self._write(entry)

    async def refused(self, peer: Peer, verb: str, reason: str) -> None:
        """Add what was refused before it came to a verb."""
        await self.note(peer, verb, reason=reason)

    async def follow_repeats(self) -> None:
        """As long as it runs: write down how often what was refused has been refused again."""
        while True:
            await asyncio.sleep(_LOOK_S)
            await self._write_repeats()

    async def close(self) -> None:
        """Write down what is still only counted."""
        await self._write_repeats(now=True)

    def last(self, count: int) -> Audit:
        """The newest `count` entries; what is not a line of ours is passed over."""
        entries: list[AuditEntry] = []
        for file in self._files.newest_first():
            entries = [*_entries(file), *entries][-count:]
            if len(entries) == count:
                break
        return Audit(file=str(self.file), unwritten=self.unwritten, entries=entries)

    async def _write_repeats(self, *, now: bool = False) -> None:
        for entry in self._repeats.over(now=now):
            entry["time"] = _now()
            await self._write(entry)

    async def _write(self, entry: AuditEntry) -> None:
        if problem := await asyncio.to_thread(self._append, entry):
            if not self.unwritten:
                self._say(f"WARNING: the audit trail {self.file} can't be written: {problem}. What is not is counted.")
            self.unwritten += 1

    def _append(self, entry: AuditEntry) -> str | None:
        """Write one line; what went wrong, or None."""
        with self._writing:
            entry["missing_before"] = self._missing
            try:
                self._files.append(json.dumps(entry))
            except OSError as problem:
                self._missing += 1
                return problem.strerror or str(problem)
            self._missing = 0
            return None


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _refused(changes: Sequence[Change]) -> list[Change]:
    brief = _brief(changes[:_REFUSED_CHANGES], _REFUSED_CHARS)
    if more := len(changes) - len(brief):
        brief.append(Change(key=f"(and {more} more)", old=None, new=None))
    return brief


def _brief(changes: Sequence[Change], chars: int = _VALUE_CHARS) -> list[Change]:
    return [
        Change(key=_cut(c["key"], _NAME_CHARS), old=_cut(c["old"], chars), new=_cut(c["new"], chars)) for c in changes
    ]


def _cut(value: Any, chars: int) -> Any:
    """`value`, or where it is too long the beginning of its text and its size."""
    text = value if isinstance(value, str) else json.dumps(value)
    if len(text) <= chars:
        return value
    return f"{text[:chars]}... (cut off, {len(text)} characters)"


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
    if not isinstance(entry, dict) or not AuditEntry.__required_keys__ <= entry.keys() <= _KEYS:
        return None
    return entry


_KEYS = AuditEntry.__annotations__.keys()
