"""What a device was given last, by the names of its outputs: a small file that outlives every process.

A worker, or ``park``, that takes over after everything was killed goes on from there where the device can't be
asked. The file lies beside the device's lock and is written by whoever holds that lock. The folder is gone after a
power cycle; a file of an earlier start of the machine counts as none, and so does that of a pseudo terminal which had
the same number before. A device that came back under another path takes its file along: `follow`.

It is written through a mapping, so that a write costs no system call. Two slots are written in turn, each between
two copies of a number that grows: a writer that is killed leaves the slot before.
"""

from __future__ import annotations

import contextlib
import json
import math
import mmap
import os
import re
import stat
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import PermissionDenied
from micromanip.files import HeldFolder

from . import device_lock
from .device_identity import identity

_HEADER_BYTES = 16384
"""The header, a line of JSON, is padded with blanks to so many bytes: names of outputs, and the machine's start."""
_TURN = struct.Struct("<q")
_START = Path("/proc/sys/kernel/random/boot_id")
_PSEUDO_TERMINALS = "/dev/pts/"


class LastGiven:
    """The file of one device, open."""

    def __init__(self, memory: mmap.mmap, count: int, path: Path | None = None) -> None:
        """`memory` is the whole file, at `path` where it lies in one, `count` the number of outputs; use `open`."""
        self._memory, self._count, self._path = memory, count, path
        self._values = struct.Struct(f"<{count}d")
        self.turn = max((turn for turn, _ in self._slots()), default=0)
        """Number of what was written last."""

    @classmethod
    def open(cls, device: str, names: Sequence[str], folder: Path | None = None) -> Self:
        """The file of `device`, made where there is none; values of outputs that it knew are kept.

        Raises PermissionDenied where it can't be made, or belongs to somebody else and can't be replaced.
        """
        return cls._of(identity(device), names, folder)

    @classmethod
    def _of(cls, device: str, names: Sequence[str], folder: Path | None) -> Self:
        """As `open`, of an identity: a link that leads elsewhere meanwhile doesn't matter any more."""
        path = _file(device, folder)
        known = _known(path, device)
        if known is None or list(known) != list(names):
            _make(path, device, names, known or {})
        try:
            descriptor = _opened(path, os.O_RDWR)
            try:
                return cls(mmap.mmap(descriptor, _size(len(names))), len(names), path)
            finally:
                os.close(descriptor)
        except (OSError, ValueError) as problem:
            raise _denied(path, device, problem) from problem

    def follow(self, device: str, names: Sequence[str], values: Sequence[float]) -> Self:
        """The file for `device`, which has just been opened: this one, or where it has come back under another path,
        one in which `values` are written at once, for what lies there may be another device's.

        Raises PermissionDenied as `open`; then this one stays as it is.
        """
        if self._path is None:
            return self
        device, folder = identity(device), self._path.parent
        if _file(device, folder) == self._path:
            return self
        there = self._of(device, names, folder)
        there.write(values)
        self.close()
        return there

    def write(self, values: Sequence[float]) -> None:
        """Remember what the device was given; NaN for an output that it was not given yet."""
        self.turn += 1
        at = self._place(self.turn % 2)
        _TURN.pack_into(self._memory, at, self.turn)
        self._values.pack_into(self._memory, at + _TURN.size, *values)
        _TURN.pack_into(self._memory, at + _TURN.size + self._values.size, self.turn)

    def read(self) -> list[float | None] | None:
        """What each output was given last, None for one that never was; None where nothing ever was given."""
        _, values = max(self._slots(), key=lambda slot: slot[0], default=(0, ()))
        found = [value if math.isfinite(value) else None for value in values]
        return found if any(value is not None for value in found) else None

    def slots(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Both slots for compiled code, as whole numbers and as values; they must be gone before it is closed."""
        memory = np.frombuffer(self._memory, np.uint8, 2 * (2 * _TURN.size + self._values.size), _HEADER_BYTES)
        return memory.view(np.int64), memory.view(np.float64)

    def close(self) -> None:
        """Let go of it; what was written stays."""
        self._memory.close()

    def _place(self, slot: int) -> int:
        return _HEADER_BYTES + slot * (2 * _TURN.size + self._values.size)

    def _slots(self) -> list[tuple[int, tuple[float, ...]]]:
        """Number and values of the slots that were written to their end."""
        found = []
        for slot in (0, 1):
            at = self._place(slot)
            (begun,) = _TURN.unpack_from(self._memory, at)
            values = self._values.unpack_from(self._memory, at + _TURN.size)
            (ended,) = _TURN.unpack_from(self._memory, at + _TURN.size + self._values.size)
            if begun == ended > 0:
                found.append((begun, values))
        return found


def _file(device: str, folder: Path | None) -> Path:
    """Where the file of a device with this identity lies: beside its lock."""
    return (device_lock.FOLDER if folder is None else folder) / (re.sub(r"[^A-Za-z0-9.-]", "_", device) + ".given")


def _size(count: int) -> int:
    return _HEADER_BYTES + 2 * (2 * _TURN.size + 8 * count)


def _start(device: str) -> str:
    """When the machine was started, and the pseudo terminal made if it is one: their numbers are given again."""
    with contextlib.suppress(OSError):
        machine = _START.read_text(encoding="ascii").strip()
        return f"{machine} {Path(device).stat().st_ctime_ns}" if device.startswith(_PSEUDO_TERMINALS) else machine
    return ""


def _opened(path: Path, flags: int) -> int:
    """A descriptor on the file if it is one, and belongs to somebody who may say what the device was given.

    That is this user and root; where the folder is a group's, everyone who may write there. Raises OSError.
    """
    descriptor = os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    found, shared = os.fstat(descriptor), path.parent.stat().st_mode & stat.S_IWOTH
    ours = found.st_uid in (0, os.geteuid()) or not shared
    if ours and stat.S_ISREG(found.st_mode) and found.st_nlink == 1:
        return descriptor
    os.close(descriptor)
    raise PermissionError(f"it belongs to user {found.st_uid}, or is no plain file")


def _known(path: Path, device: str) -> Mapping[str, float] | None:
    """Values (NaN: never given) by the outputs' names, of a whole file of `device` and this start of the machine."""
    try:
        descriptor = _opened(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        header = json.loads(os.pread(descriptor, _HEADER_BYTES, 0))
        names, count = list(header["names"]), len(header["names"])
        if (header["device"], header["start"]) != (device, _start(device)):
            return None
        if os.fstat(descriptor).st_size != _size(count):
            return None
        with mmap.mmap(descriptor, _size(count), prot=mmap.PROT_READ) as memory:
            values = LastGiven(memory, count).read() or [None] * count
        pairs = zip(names, values, strict=True)
        return {str(name): math.nan if value is None else value for name, value in pairs}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    finally:
        os.close(descriptor)


def _make(path: Path, device: str, names: Sequence[str], known: Mapping[str, float]) -> None:
    """A new file in place of the one that may be there, never a part of one."""
    header = json.dumps({"device": device, "start": _start(device), "names": list(names)}).encode()
    if len(header) >= _HEADER_BYTES:
        raise PermissionDenied(f"device {device} has too many outputs for {path}")
    with mmap.mmap(-1, _size(len(names))) as memory:
        memory.write(header.ljust(_HEADER_BYTES))
        LastGiven(memory, len(names)).write([known.get(name, math.nan) for name in names])
        content = memory[:]
    try:
        with HeldFolder(path.parent) as folder:
            folder.write(path.name, content, 0o660 if folder.status().st_mode & stat.S_ISGID else 0o600)
    except OSError as problem:
        raise _denied(path, device, problem) from problem


def _denied(path: Path, device: str, problem: Exception) -> PermissionDenied:
    why = problem.strerror if isinstance(problem, OSError) and problem.strerror else str(problem)
    return PermissionDenied(
        f"what device {device} is given can't be remembered in {path}: {why}; see docs/your-cell.md"
    )
