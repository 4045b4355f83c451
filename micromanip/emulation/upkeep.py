"""When a device that compiled code serves has its turns in Python: watchdogs, amplifier, figures."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

from micromanip.testbus.event_loop import EventLoop

_IDLE_NS = 1_000_000
_SERVED_NS = 4_000_000
_GONE_NS = 6_000_000
"""While frames are served, one turn each `_SERVED_NS` right behind one of them; after so long without, as when idle."""


class Upkeep:
    """Calls back each millisecond; while frames come, one of the callbacks each four, in the pause behind a frame.

    All of them together take as long as a cycle of the loop: wherever they lay, the next frame came back late.
    """

    def __init__(self, loop: EventLoop, turns: tuple[Callable[[], None], ...]) -> None:
        self._loop, self._turns = loop, turns
        self._next = cycle(turns)
        self._looked_ns, self._serves = 0, False

    @property
    def due_ns(self) -> int:
        """When a turn is due behind a frame."""
        return self._looked_ns + _SERVED_NS

    def start(self) -> None:
        """Begin, with all turns at once."""
        self._all(self._loop.now_ns())
        self._wait()

    def behind_a_frame(self) -> None:
        """A frame has been served: the next one is not there yet."""
        self._serves, now_ns = True, self._loop.now_ns()
        if now_ns >= self.due_ns:
            self._looked_ns = now_ns
            next(self._next)()

    def _is_due(self) -> None:
        now_ns = self._loop.now_ns()
        if now_ns - self._looked_ns >= (_GONE_NS if self._serves else _IDLE_NS):
            self._serves = False
            self._all(now_ns)
        self._wait()

    def _all(self, now_ns: int) -> None:
        self._looked_ns = now_ns
        for turn in self._turns:
            turn()

    def _wait(self) -> None:
        self._loop.call_at(self._looked_ns + (_GONE_NS if self._serves else _IDLE_NS), self._is_due)
