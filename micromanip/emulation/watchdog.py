"""A watch over who commands a emulated device."""

from __future__ import annotations

from collections.abc import Callable

from micromanip.testbus.event_loop import EventLoop, Timer

_LATE_NS = 2_000_000
"""A timer that comes later than this was not late: this process stood still."""


class Watchdog:
    """Calls `bite` when nothing has fed it for a time; begins with the first time that it is fed.

    A device has a processor of its own; this process may be held up, and what it was fed meanwhile is not read yet, or
    found no room. So after having stood still it waits once more for as long.
    """

    def __init__(self, loop: EventLoop, bite: Callable[[], None]) -> None:
        self._loop, self._bite = loop, bite
        self._timer: Timer | None = None
        self._fed_ns = self._patience_ns = 0

    def feed(self, time_ns: int, patience_ns: int) -> None:
        """Something came at `time_ns`; the next is due within `patience_ns`."""
        self._fed_ns, self._patience_ns = max(self._fed_ns, time_ns), patience_ns
        if self._timer is None:
            self._wait()

    def stop(self) -> None:
        """Watch no more, until it is fed again."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _wait(self) -> None:
        due_ns = self._fed_ns + self._patience_ns
        self._timer = self._loop.call_at(due_ns, lambda: self._look(due_ns))

    def _look(self, due_ns: int) -> None:
        now_ns = self._loop.now_ns()
        if now_ns - due_ns > _LATE_NS:
            self._fed_ns = now_ns
        if now_ns < self._fed_ns + self._patience_ns:
            self._wait()
        else:
            self._timer = None
            self._bite()
