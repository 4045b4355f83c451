"""Reading from any python-can interface but SocketCAN."""

from __future__ import annotations

import select
import time

import can


class BusReader:
    """Frames of a python-can bus, each with the time of its reception in CLOCK_MONOTONIC.

    The time is that of being read: clocks of vendors' drivers start anywhere, drift, and some jump. The test bus alone
    stamps in CLOCK_MONOTONIC, and says so.
    """

    overflows = 0

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._fileno = _fileno(bus)
        self._first: list[tuple[can.Message, int]] = []  # what waiting for it has taken already
        self._stamped = getattr(bus, "timestamp_clock", None) == "CLOCK_MONOTONIC"

    def drain(self, limit: int) -> list[tuple[can.Message, int]]:
        """What is there, `limit` frames at most. Raises CanError, OSError."""
        receive, stamped = self._bus.recv, self._stamped
        frames, self._first = self._first, []
        while len(frames) < limit:
            message = receive(0)
            if message is None:
                break
            frames.append((message, _stamp_ns(message) if stamped else time.monotonic_ns()))
        if stamped and frames and frames[-1][1] > (now_ns := time.monotonic_ns()):
            return [(message, min(time_ns, now_ns)) for message, time_ns in frames]
        return frames

    def wait(self, seconds: float) -> None:
        """Until a frame is there, or so long."""
        if self._fileno is not None:
            select.select([self._fileno], [], [], seconds)
        elif (message := self._bus.recv(seconds)) is not None:
            self._first = [(message, _stamp_ns(message) if self._stamped else time.monotonic_ns())]


def _stamp_ns(message: can.Message) -> int:
    return round(message.timestamp * 1e9)


def _fileno(bus: can.BusABC) -> int | None:
    try:
        fileno = bus.fileno()
    except NotImplementedError:
        return None
    return fileno if fileno >= 0 else None
