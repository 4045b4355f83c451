"""Who is at the other end of the control socket, as the kernel says, and what they may do."""

from __future__ import annotations

import functools
import os
import pwd
import socket
import struct
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from micromanip.errors import PermissionDenied

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


class Right(StrEnum):
    """What a verb takes: `OBSERVE` changes nothing, `OPERATE` moves something or changes what runs."""

    OBSERVE = "observe"
    OPERATE = "operate"


@dataclass(frozen=True)
class Authority:
    """Numbers of the groups whose members operate and observe; root and the controller's own user always do both."""

    operators: int
    observers: int | None = None

    def allows(self, peer: Peer, right: Right) -> bool:
        """Whoever operates may observe, too."""
        if peer.uid in (0, os.geteuid()) or self.operators in peer.groups:
            return True
        return right is Right.OBSERVE and self.observers in peer.groups

    def demand(self, peer: Peer, right: Right, verb: str) -> None:
        """Raise PermissionDenied where `peer` has not the `right` that `verb` takes."""
        if not self.allows(peer, right):
            may = "only observe" if self.allows(peer, Right.OBSERVE) else "do nothing here"
            raise PermissionDenied(
                f"{verb} refused: {peer.user} may {may}; to {right} takes to be in the group "
                f"that control.{right}_group names, at the time of connecting"
            )
