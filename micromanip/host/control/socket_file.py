"""The control socket in the file system: for nobody too many, taken over from a dead controller, never from others.

A group that the controller's own user is not a member of can't be given the socket; it is then let in by an access
control list, as is the group that only observes.
"""

from __future__ import annotations

import contextlib
import errno
import grp
import os
import socket
import stat
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from micromanip.errors import CheckFailed, PermissionDenied, UsageError

from .authority import Authority

_ANSWER_S = 1.0
_ACL = "system.posix_acl_access"
_ACL_VERSION, _ACL_ENTRY = struct.pack("<I", 2), struct.Struct("<HHI")
_USER_OBJ, _GROUP_OBJ, _GROUP, _MASK, _OTHER, _NOBODY = 0x01, 0x04, 0x08, 0x10, 0x20, 0xFFFFFFFF
_MODE, _MAY = 0o660, 6  # others have no access


@dataclass(frozen=True)
class Access:
    """Who may connect beside the controller's user: the group that operates and the one that only observes."""

    operate_group: str | None = None
    observe_group: str | None = None

    @property
    def operators(self) -> int | None:
        """Number of the group that operates; None: the controller's own."""
        return None if self.operate_group is None else _group_id("operate_group", self.operate_group)

    @property
    def observers(self) -> int | None:
        """Number of the group that observes."""
        return None if self.observe_group is None else _group_id("observe_group", self.observe_group)


def claim(path: Path) -> None:
    """Make room for the socket: its folder exists, and no living daemon answers on it.

    Raises CheckFailed where one does, or where the path is anything but a dead one's socket.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_stale(path)
    if path.is_socket():
        raise CheckFailed(f"another controller answers on {path}; stop it first, or choose another --socket")
    if path.exists() or path.is_symlink():
        raise CheckFailed(f"{path} is not a socket and stays as it is; choose another --socket")


def remove_stale(path: Path) -> None:
    """Remove the socket of a dead daemon; whatever else is there is left alone."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, contextlib.suppress(OSError):
        probe.settimeout(_ANSWER_S)  # of one that lives, but does not answer
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            if path.is_socket():
                path.unlink()


def bound(path: Path, access: Access) -> tuple[socket.socket, Authority]:
    """A socket bound at `path` that is at no moment open to more than `access` says, and what whoever comes may do.

    Raises OSError where it can't be, UsageError or PermissionDenied where a group is unknown or can't be let in.
    """
    operators, observers = access.operators, access.observers
    bound = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        bound.bind(str(path))
    except OSError:
        bound.close()
        raise
    finally:
        os.umask(before)
    try:
        with _pinned(path) as place:
            own = place.stat().st_gid
            _let_in(place, operators, observers)
    except BaseException:
        bound.close()
        path.unlink(missing_ok=True)
        raise
    return bound, Authority(own if operators is None else operators, observers)


@contextlib.contextmanager
def _pinned(path: Path) -> Iterator[Path]:
    """A path that means the socket itself, whatever somebody puts into its place meanwhile."""
    handle = os.open(path, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        found = os.fstat(handle)
        if not stat.S_ISSOCK(found.st_mode) or found.st_uid != os.geteuid():
            raise CheckFailed(f"{path} was replaced while it was made; choose a --socket where only you can write")
        yield Path(f"/proc/self/fd/{handle}")
    finally:
        os.close(handle)


def _let_in(place: Path, operators: int | None, observers: int | None) -> None:
    """Open the socket to its own group, or to these."""
    listed = [] if observers is None else [observers]
    own_group = _MAY
    if operators is not None:
        try:
            os.chown(place, -1, operators)
        except OSError as problem:
            if problem.errno not in (errno.EPERM, errno.EINVAL):
                raise
            listed.append(operators)  # not a group of ours
            own_group = 0
    if not listed:
        place.chmod(_MODE)
        return
    entries = [
        (_USER_OBJ, _MAY, _NOBODY),
        (_GROUP_OBJ, own_group, _NOBODY),
        *((_GROUP, _MAY, group) for group in sorted(set(listed))),
        (_MASK, _MAY, _NOBODY),
        (_OTHER, 0, _NOBODY),
    ]
    try:
        os.setxattr(place, _ACL, _ACL_VERSION + b"".join(_ACL_ENTRY.pack(*entry) for entry in entries))
    except OSError as problem:
        raise PermissionDenied(
            f"control: the groups can't be let in: {problem.strerror}; it takes a file system with access control "
            "lists (/run has them), and no user namespace (PrivateUsers=no in the unit)"
        ) from problem


def _group_id(key: str, name: str) -> int:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise UsageError(
            f"control.{key}: there is no group {name} on this machine; `groupadd {name}` makes it"
        ) from None
