"""When the kernel received what comes by a socket (SO_TIMESTAMPNS), in CLOCK_MONOTONIC."""

from __future__ import annotations

import socket
import struct
import time

_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@ll")
ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)


class KernelTimes:
    """Of one socket, as far as a wall clock that may be stepped can tell them.

    They count within what is known for sure: each came after the one before it and after the queue was last seen empty,
    and before now. The monotonic clock is read first: if this process is stalled in between, what came looks older,
    never newer than it is.
    """

    def __init__(self, opened: socket.socket) -> None:
        opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.queue_is_empty()

    def queue_is_empty(self) -> None:
        """What is received from now on came after this moment."""
        self._earliest_ns = time.monotonic_ns()

    def received_ns(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        """Of what came with these data; now where the kernel says nothing."""
        now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        for _, kind, data in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
                self._earliest_ns = min(now_ns, max(self._earliest_ns, now_ns - (wall_ns - stamp_ns)))
                return self._earliest_ns
        return now_ns
