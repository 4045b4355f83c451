"""When a device that compiled code serves has its turns in Python: watchdogs, amplifier, figures."""

from __future__ import annotations

from collections.abc import Callable

from micromanip.testbus.event_loop import EventLoop, Timer

_IDLE_NS = 1_000_000
_GONE_NS = 2_000_000
"""So long after a turn was due behind a frame there is none."""


class Upkeep:
    """Calls back each millisecond; while frames come, each `served_ns`, in the pause behind one."""

    def __init__(self, loop: EventLoop, turn: Callable[[], None], served_ns: int) -> None:
        self._loop, self._turn, self._served_ns = loop, turn, served_ns
        self._looked_ns, self._serves = 0, False
        self._timer: Timer | None = None

    @property
    def due_ns(self) -> int:
        """When a turn is due behind a frame."""
        return self._looked_ns + self._served_ns

    def start(self) -> None:
        """Begin, also anew when nobody sends frames any more: with a turn at once, and then each millisecond."""
        self._serves, self._looked_ns = False, self._loop.now_ns()
        self._turn()
        self._wait()

    def behind_a_frame(self) -> None:
        """A frame has been served: the next one is not there yet."""
        self._serves, now_ns = True, self._loop.now_ns()
        if now_ns >= self.due_ns:
            self._looked_ns = now_ns
            self._turn()
            self._wait()

    def serves_no_more(self) -> None:
        """Compiled code serves no frames, or none come: have a turn now, where that is new, and each millisecond."""
        if self._serves:
            self.start()

    def _wait(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_at(self._gone_ns, self._is_gone)

    @property
    def _gone_ns(self) -> int:
        return self.due_ns + _GONE_NS if self._serves else self._looked_ns + _IDLE_NS

    def _is_gone(self) -> None:
        if self._loop.now_ns() >= self._gone_ns:
            self.start()
        else:
            self._wait()
