"""One controller a device: a lock that lives exactly as long as a process that can move its outputs.

``flock`` on a file belongs to the open descriptor. The host takes it before anything is opened and the loop process
inherits it, so it is held until the last of the two has ended, in whatever way, ``kill -9`` included. Then the
kernel lets go of it; the empty file stays and means nothing.

The files lie in one folder for the whole machine (``docs/decisions/0013-one-lock-folder.md``).
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from micromanip.errors import DeviceUnavailable, PermissionDenied

FOLDER = Path("/run/lock/micromanip")
_POLL_S = 0.05


class DeviceLocks:
    """Locks on several devices, all or none."""

    def __init__(self, devices: Iterable[str], folder: Path | None = None, wait_s: float = 0.0) -> None:
        """Take them, for those in use waiting up to `wait_s`.

        Raises DeviceUnavailable where one stays in use, PermissionDenied where the folder is not for this user.
        """
        self._folder = FOLDER if folder is None else folder
        self.descriptors: tuple[int, ...] = ()
        """To pass to a process that can move the outputs too."""
        end = time.monotonic() + wait_s
        try:
            for device in sorted(set(devices)):  # in order: two that want the same ones can't wait for each other
                descriptor = self._open(device)
                self.descriptors += (descriptor,)
                self._lock(descriptor, device, end)
        except BaseException:
            self.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def release(self) -> None:
        """Let go of them in this process; one that inherited them still holds them."""
        for descriptor in self.descriptors:
            os.close(descriptor)
        self.descriptors = ()

    def _open(self, device: str) -> int:
        path = self._folder / (re.sub(r"[^A-Za-z0-9.-]", "_", device) + ".lock")
        try:
            if not self._folder.is_dir():
                self._folder.mkdir()
                self._folder.chmod(0o1777)  # everybody's, as the folder around it, until the service is installed
            with contextlib.suppress(FileNotFoundError):  # without O_CREAT: a sticky folder denies it for others' files
                return os.open(path, os.O_RDWR | os.O_CLOEXEC)
            descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_CREAT, 0o660)
            with contextlib.suppress(PermissionError):  # somebody else made it just now
                os.fchmod(descriptor, 0o660 if self._folder.stat().st_mode & 0o2000 else 0o666)
        except OSError as problem:
            raise PermissionDenied(
                f"device {device} can't be locked ({problem.strerror}: {path}); your user must be in the group of "
                f"{self._folder}, and that folder must be there: see docs/service.md"
            ) from problem
        return descriptor

    def _lock(self, descriptor: int, device: str, end: float) -> None:
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as problem:
                if time.monotonic() < end:
                    time.sleep(_POLL_S)
                    continue
                holder = os.pread(descriptor, 20, 0).decode(errors="replace").strip()
                who = f"process {holder}" if holder.isdigit() else "another process"
                raise DeviceUnavailable(
                    f"device {device} is in use by another controller ({who}, or the loop that it left); stop it first"
                ) from problem
            with contextlib.suppress(OSError):  # a full disk: the number is for the message only
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
            return
