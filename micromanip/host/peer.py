"""Who is at the other end of a Unix socket, as the kernel says."""

from __future__ import annotations

import functools
import os
import pwd
import socket
import struct
from dataclasses import dataclass
from typing import Self

_CREDENTIALS = struct.Struct("3i")
_SO_PEERGROUPS = 59  # of Linux 4.13 and newer; Python has no name for it
_MOST_BYTES = 1024  # that Python asks the kernel for: 256 groups


@dataclass(frozen=True)
class Peer:
    """A user and a process; without numbers it is the controller's own configuration or a signal."""

    user: str
    uid: int | None = None
    pid: int | None = None
    groups: frozenset[int] = frozenset()
    """Numbers of all groups that it was in when it connected."""

    @classmethod
    def of(cls, connection: socket.socket) -> Self:
        """The process that connected, by SO_PEERCRED and SO_PEERGROUPS: it can't claim to be another."""
        answer = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        pid, uid, gid = _CREDENTIALS.unpack(answer)
        return cls(_name(uid), uid, pid, frozenset({gid, *_groups(connection, uid, gid)}))


def _groups(connection: socket.socket, uid: int, gid: int) -> list[int]:
    try:
        answer = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _MOST_BYTES)
    except OSError:  # more of them than that, or an older kernel: those that the user has by the system's tables
        try:
            return os.getgrouplist(pwd.getpwuid(uid).pw_name, gid)
        except KeyError:
            return []
    return list(struct.unpack(f"{len(answer) // 4}I", answer))


@functools.lru_cache(maxsize=256)
def _name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"uid {uid}"
