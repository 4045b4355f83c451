"""One controller a device: a lock that lives exactly as long as a process that can move its outputs.

``flock`` on a file belongs to the open descriptor. The host takes it before anything is opened and the loop process
inherits it, so it is held until the last of the two has ended, in whatever way, ``kill -9`` included. Then the
kernel lets go of it; the empty file stays and means nothing.

The files lie in one folder for the whole machine, which must be root's or this user's, and a device has a lock for each
name that it goes by (``docs/decisions/0013-one-lock-folder.md``).
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import stat
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from micromanip.errors import DeviceUnavailable, PermissionDenied

from .device_identity import identities

FOLDER = Path("/run/lock/micromanip")
_LOCKS = Path("/proc/locks")
_POLL_S = 0.05


class DeviceLocks:
    """Locks on several devices, all or none."""

    def __init__(self, devices: Iterable[str], folder: Path | None = None, wait_s: float = 0.0) -> None:
        """Take them, for those in use waiting up to `wait_s`.

        Raises DeviceUnavailable where one stays in use, PermissionDenied where the folder is not for this user, or is
        somebody else's, who could give the same device to two.
        """
        self._folder = FOLDER if folder is None else folder
        self.descriptors: tuple[int, ...] = ()
        """To pass to a process that can move the outputs too."""
        end = time.monotonic() + wait_s
        names = {name: device for device in set(devices) for name in identities(device)}
        if not names:
            return
        at = self._open_folder(min(names.values()))
        try:
            for name, device in sorted(names.items()):  # in order: two that want the same can't wait for each other
                self.descriptors += (self._take(at, name, device, end),)
        except BaseException:
            self.release()
            raise
        finally:
            os.close(at)

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

    def _open_folder(self, device: str) -> int:
        """A descriptor of the folder, made where there is none."""
        try:
            with contextlib.suppress(FileExistsError):
                self._folder.mkdir()
                self._folder.chmod(0o1777)  # everybody's, as the folder around it, until the service is installed
            descriptor = os.open(self._folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError as problem:
            raise self._denied(device, f"{problem.strerror}: {self._folder}") from problem
        if why := _not_to_be_trusted(os.fstat(descriptor)):
            os.close(descriptor)
            raise PermissionDenied(
                f"device {device} can't be locked: {self._folder} {why}: another controller could be given the same "
                f"device; let root have it (sudo chown root {self._folder} && sudo chmod 1777 {self._folder}), or "
                "install the service, see docs/your-cell.md"
            )
        return descriptor

    def _take(self, at: int, name: str, device: str, end: float) -> int:
        """The lock `name` of `device`, in the folder `at`."""
        file = re.sub(r"[^A-Za-z0-9.-]", "_", name) + ".lock"
        while True:
            descriptor = self._open(at, file, device)
            try:
                self._lock(at, file, descriptor, device, end)
                if _is_still(at, file, descriptor):
                    return descriptor
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)  # of a file that was taken away meanwhile: the next one who comes locks another

    def _open(self, at: int, file: str, device: str) -> int:
        flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            try:  # without O_CREAT: a sticky folder denies it for others' files
                descriptor = os.open(file, flags, dir_fd=at)
            except FileNotFoundError:
                descriptor = os.open(file, flags | os.O_CREAT, 0o660, dir_fd=at)
                with contextlib.suppress(PermissionError):  # somebody else made it just now
                    os.fchmod(descriptor, 0o660 if os.fstat(at).st_mode & stat.S_ISGID else 0o666)
        except OSError as problem:
            raise self._denied(device, f"{problem.strerror}: {self._folder / file}") from problem
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
            os.close(descriptor)
            raise PermissionDenied(
                f"device {device} can't be locked: {self._folder / file} is no plain file; remove it"
            )
        return descriptor

    def _denied(self, device: str, why: str) -> PermissionDenied:
        return PermissionDenied(
            f"device {device} can't be locked ({why}); your user must be in the group of {self._folder}, and that "
            "folder must be there: see docs/your-cell.md"
        )

    def _lock(self, at: int, file: str, descriptor: int, device: str, end: float) -> None:
        """Take the lock, or take away the file of one that a stranger holds, who is no controller."""
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as problem:
                if os.geteuid() == 0 and _is_a_strangers(descriptor):
                    if _is_still(at, file, descriptor):
                        os.unlink(file, dir_fd=at)
                    return
                if time.monotonic() < end:
                    time.sleep(_POLL_S)
                    continue
                raise DeviceUnavailable(
                    f"device {device} is in use by another controller ({_holder(descriptor)}, or the loop that it "
                    "left); stop it first"
                ) from problem
            with contextlib.suppress(OSError):  # a full disk: the number is for the message only
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
            return


def _holder(descriptor: int) -> str:
    """Who has the lock, as the kernel says: anybody may hold one in a folder of everybody's, and write any number."""
    found = os.fstat(descriptor)
    place = f"{os.major(found.st_dev):02x}:{os.minor(found.st_dev):02x}:{found.st_ino}"
    with contextlib.suppress(OSError):
        for line in _LOCKS.read_text(encoding="ascii").splitlines():
            _, kind, _, _, number, where, *_ = line.replace("->", "").split()
            if kind == "FLOCK" and where == place and Path(f"/proc/{number}").is_dir():
                uid = Path(f"/proc/{number}").stat().st_uid
                unit = Path(f"/proc/{number}/cgroup").read_text(encoding="utf-8").strip().rpartition("/")[2]
                told = f", `systemctl stop {unit}`" if unit.endswith(".service") else ""
                return f"process {number}" + ("" if uid == os.geteuid() else f" of user {uid}") + told
    said = os.pread(descriptor, 20, 0).decode(errors="replace").strip()
    return f"process {said}" if said.isdigit() else "another process"


def _is_a_strangers(descriptor: int) -> bool:
    """Whether all that have this file open are other users' processes which run nothing of ours; for root only.

    The kernel's word for the lock is who took it, who may have ended; who holds it has the file open.
    """
    found, holders = os.fstat(descriptor), []
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and int(process.name) != os.getpid():
            with contextlib.suppress(OSError):
                if any(_is_file(entry, found) for entry in (process / "fd").iterdir()):
                    holders.append(process)
    return bool(holders) and not any(_may_control(process) for process in holders)


def _is_file(entry: Path, found: os.stat_result) -> bool:
    with contextlib.suppress(OSError):
        return os.path.samestat(entry.stat(), found)
    return False


def _may_control(process: Path) -> bool:
    try:
        if process.stat().st_uid == 0:
            return True
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return True  # gone, or hidden: asked again
    return any(word.startswith(b"micromanip.") or word.rpartition(b"/")[2] == b"micromanip" for word in words)


def _not_to_be_trusted(folder: os.stat_result) -> str | None:
    """Why whoever else may change the folder could take a lock away from under its holder; None where nobody can."""
    if folder.st_uid not in (0, os.geteuid()):
        return f"belongs to user {folder.st_uid}, neither root nor you"
    if folder.st_mode & stat.S_IWOTH and not folder.st_mode & stat.S_ISVTX:
        return "can be changed by everybody and is not sticky"
    if folder.st_mode & stat.S_IWGRP and folder.st_uid != 0 and not folder.st_mode & stat.S_ISVTX:
        return f"can be changed by the group {folder.st_gid} and is not sticky"
    return None


def _is_still(at: int, file: str, descriptor: int) -> bool:
    """Whether the file of that name is the one that is open."""
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.stat(file, dir_fd=at, follow_symlinks=False), os.fstat(descriptor))
    return False
