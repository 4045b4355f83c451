"""The files of a trend: lines at their end, whole or not at all, and old days removed."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import stat
from pathlib import Path

from micromanip.recordings.trend import MINUTE, SECOND, day_file, file_name

_TAIL_BYTES = 1 << 16
"""More than a line has."""


class TrendFiles:
    """One folder, which is locked while this is open: lines of two controllers would be mixed."""

    def __init__(self, folder: Path, header: str, keep_days: dict[str, int], quota_bytes: int) -> None:
        """Makes the folder where it is not there; `keep_days` by the kind of the lines. Raises OSError."""
        self._folder, self._head, self._keep, self._quota = folder, f"{header}\n".encode(), keep_days, quota_bytes
        self._open: dict[str, tuple[str, int]] = {}
        """Day and descriptor of the file that lines of each kind go to."""
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as problem:
            os.close(self._lock)
            if problem.errno != errno.EWOULDBLOCK:
                raise
            raise OSError(problem.errno, "another controller keeps its trend there", str(folder)) from problem

    def append(self, every: str, day: str, line: str) -> None:
        """Add a line to the file of that day. Raises OSError, and the file is as it was."""
        if self._open.get(every, ("", -1))[0] != day:
            self._turn_to(every, day)
        _append(self._open[every][1], f"{line}\n".encode())
        if every == MINUTE:
            self._remove_old()

    def close(self) -> None:
        """Let the files and the folder go."""
        for _, descriptor in self._open.values():
            os.close(descriptor)
        self._open.clear()
        os.close(self._lock)

    def _turn_to(self, every: str, day: str) -> None:
        _, old = self._open.pop(every, ("", -1))
        if old >= 0:
            os.close(old)
        for number in itertools.count(1):
            descriptor = self._opened(self._folder / file_name(day, every, number))
            if descriptor is not None:
                self._open[every] = (day, descriptor)
                break
        self._remove_old()

    def _opened(self, file: Path) -> int | None:
        """`file`, ready for a line; None where it has other columns."""
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        descriptor = os.open(file, flags, 0o644)
        try:
            _require_regular(descriptor, file)
            head = os.pread(descriptor, len(self._head), 0)
            if head == self._head:
                _cut_torn(descriptor)
                return descriptor
            if self._head.startswith(head):  # new, or its writer was killed at once
                os.ftruncate(descriptor, 0)
                _append(descriptor, self._head)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
        return None

    def _remove_old(self) -> None:
        """Remove days beyond those that are kept, then seconds, then minutes, until the rest fits; never today's."""
        found = [each for path in self._folder.iterdir() if (each := day_file(path)) is not None and _is_plain(path)]
        sizes = {each: each.path.stat().st_size for each in found}
        present = {day for day, _ in self._open.values()}  # where a clock was set back, not the newest
        for every in (SECOND, MINUTE):
            days = sorted({each.day for each in found if each.every == every})
            surplus = len(days) - self._keep[every]
            for count, day in enumerate(days):
                if day in present or (count >= surplus and sum(sizes.values()) <= self._quota):
                    continue
                for each in [each for each in sizes if (each.every, each.day) == (every, day)]:
                    each.path.unlink(missing_ok=True)
                    del sizes[each]


def _is_plain(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def _require_regular(descriptor: int, file: Path) -> None:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(file))


def _append(descriptor: int, data: bytes) -> None:
    size = os.fstat(descriptor).st_size
    try:
        rest = memoryview(data)
        while rest:  # a full disk takes a part, and refuses what is left
            rest = rest[os.write(descriptor, rest) :]
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(descriptor, size)
        raise


def _cut_torn(descriptor: int) -> None:
    """Remove what stands behind the last newline: a line that a kill or a power cut has left unfinished."""
    size = os.fstat(descriptor).st_size
    begin = max(0, size - _TAIL_BYTES)
    whole = begin + os.pread(descriptor, _TAIL_BYTES, begin).rfind(b"\n") + 1
    if whole < size:
        os.ftruncate(descriptor, whole)
