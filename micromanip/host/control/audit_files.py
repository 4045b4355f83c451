"""The files of the audit trail: one per day, synchronised line by line, bounded in all.

``audit.jsonl`` is today's; a day that is over, or a part of it that has grown large, becomes ``audit-DATE.N.jsonl``.
Where all together are too large, days that are over for long go first, then the day with most bytes loses its oldest
part: a burst pushes out itself, not what was there before.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

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
    """The files in one folder."""

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
