"""Who is at the other end of a Unix socket, as the kernel says."""

from __future__ import annotations

import pwd
import socket
import struct
from dataclasses import dataclass
from typing import Self

_CREDENTIALS = struct.Struct("3i")


@dataclass(frozen=True)
class Peer:
    """A user and a process; without numbers it is the controller's own configuration or a signal."""

    user: str
    uid: int | None = None
    pid: int | None = None

    @classmethod
    def of(cls, connection: socket.socket) -> Self:
        """The process that connected, by SO_PEERCRED: it can't claim to be another."""
        answer = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        pid, uid, _ = _CREDENTIALS.unpack(answer)
        return cls(_name(uid), uid, pid)


def _name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"uid {uid}"
