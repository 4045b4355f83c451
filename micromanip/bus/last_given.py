"""What a device was given last, by the names of its outputs: a small file that outlives every process.

A worker, or ``park``, that takes over after everything was killed goes on from there where the device can't be
asked. The file lies beside the device's lock and is written by whoever holds that lock. The folder is gone after a
power cycle; a file of an earlier start of the machine, or one that is not known, counts as none, and so does that of a
pseudo terminal which had the same number before. A device that came back under another path takes its file along:
`follow`.

Two slots are written in turn, each a number that grows, the values, and a checksum of them and the header: a writer
that is killed leaves the slot before, and what is not whole counts as nothing. A write is one system call: a file that
somebody cuts short would end a process that has it mapped.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import stat
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import PermissionDenied
from micromanip.files import HeldFolder
from micromanip.rt.io.worker_records import MEMORY, sealed, size
from micromanip.rt.record import fields

from . import device_lock
from .device_identity import identity

_HEADER_BYTES = 16384
"""The header, a line of JSON, is padded with blanks to so many bytes: names of outputs, and the machine's start."""
_START = Path("/proc/sys/kernel/random/boot_id")
_PSEUDO_TERMINALS = "/dev/pts/"


class LastGiven:
    """The file of one device, open."""

    def __init__(self, descriptor: int, count: int, path: Path | None = None) -> None:
        """`descriptor` is that of the whole file, at `path`, `count` the number of outputs; use `open`."""
        self._descriptor, self._path = descriptor, path
        self.record = np.zeros(1, MEMORY)
        """In which compiled turns go on."""
        self._words = self.record[0]["slot"][: size(count)]
        self._values = self._words.view(np.float64)
        self._memory = memory = fields(self.record[0])
        memory["file"][0], memory["seed"][0] = descriptor, zlib.crc32(os.pread(descriptor, _HEADER_BYTES, 0))
        memory["place"][0], memory["place"][1] = _HEADER_BYTES, _HEADER_BYTES + self._words.nbytes
        memory["turn"][0] = max((int(slot[0]) for slot in self._slots()), default=0)

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
            return cls(_opened(path, os.O_RDWR), len(names), path)
        except (OSError, ValueError) as problem:
            raise _denied(path, device, problem) from problem

    def follow(self, device: str, names: Sequence[str], values: Sequence[float]) -> Self:
        """The file for `device`, which has just been opened: this one, or where it has come back under another path, or
        as a new terminal of the same number, one in which `values` are written at once: its own may be another's.

        Raises PermissionDenied as `open`; then this one stays as it is.
        """
        if self._path is None:
            return self
        device, folder = identity(device), self._path.parent
        if _file(device, folder) == self._path and _known(self._path, device) is not None:
            return self
        there = self._of(device, names, folder)
        there.write(values)
        self.close()
        return there

    def write(self, values: Sequence[float]) -> None:
        """Remember what the device was given; NaN for an output that it was not given yet."""
        memory = self._memory
        turn = memory["turn"][0] + 1
        memory["turn"][0] = self._words[0] = turn
        self._values[1:-1] = values
        self._words[-1] = sealed(self._words, memory["seed"][0])
        os.pwrite(self._descriptor, self._words.tobytes(), memory["place"][turn % 2])

    def read(self) -> list[float | None] | None:
        """What each output was given last, None for one that never was; None where nothing ever was given."""
        slots = self._slots()
        if not slots:
            return None
        values = max(slots, key=lambda slot: int(slot[0])).view(np.float64)[1:-1]
        found = [float(value) if math.isfinite(value) else None for value in values]
        return found if any(value is not None for value in found) else None

    def close(self) -> None:
        """Let go of it; what was written stays."""
        os.close(self._descriptor)

    def _slots(self) -> list[NDArray[np.int64]]:
        """Those that are whole."""
        found, size = [], self._words.nbytes
        for turn, place in enumerate(self._memory["place"]):
            data = os.pread(self._descriptor, size, place)
            slot = np.frombuffer(data, np.int64) if len(data) == size else np.zeros_like(self._words)
            if slot[0] > 0 and slot[0] % 2 == turn and slot[-1] == sealed(slot, self._memory["seed"][0]):
                found.append(slot)
        return found


def _file(device: str, folder: Path | None) -> Path:
    """Where the file of a device with this identity lies: beside its lock."""
    return (device_lock.FOLDER if folder is None else folder) / (re.sub(r"[^A-Za-z0-9.-]", "_", device) + ".given")


def _size(count: int) -> int:
    return _HEADER_BYTES + 2 * 8 * size(count)


def _start(device: str) -> str:
    """When the machine was started, and the pseudo terminal made if it is one (their numbers recur); "": not known."""
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
        if not header["start"] or (header["device"], header["start"]) != (device, _start(device)):
            return None
        if os.fstat(descriptor).st_size != _size(count):
            return None
        values = LastGiven(descriptor, count).read() or [None] * count
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
    header = header.ljust(_HEADER_BYTES)
    first = np.zeros(size(len(names)), np.int64)
    first[0], first.view(np.float64)[1:-1] = 1, [known.get(name, math.nan) for name in names]
    first[-1] = sealed(first, zlib.crc32(header))
    content = header + bytes(first.nbytes) + first.tobytes()
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
