"""A single-threaded event loop with timers that are microseconds fine, for simulated devices.

asyncio rounds its waits to milliseconds; a CAN frame takes a tenth of one. Time is CLOCK_MONOTONIC in nanoseconds.
"""

from __future__ import annotations

import ctypes
import heapq
import math
import os
import select
import time
from collections.abc import Callable, Sequence

_PR_SET_TIMERSLACK = 29
_SLACK_NS = 1
_BUSY_NS, _PAUSE_S = 20_000_000, 0.002
_RESTED_NS = 20_000
"""A wait that took less was none."""
_libc = ctypes.CDLL(None)


class Timer:
    """A call that is to come; ``cancel`` may be called at any time, also after it came."""

    __slots__ = ("callback", "time_ns")

    def __init__(self, time_ns: int, callback: Callable[[], None]) -> None:
        self.time_ns = time_ns
        self.callback: Callable[[], None] | None = callback

    def cancel(self) -> None:
        """Forget the call."""
        self.callback = None


Serve = Callable[[Sequence[int], int | None], int]
"""Waits in the loop's stead, see ``EventLoop.serve_by``: for these descriptors, and until that time."""


class EventLoop:
    """Calls back when descriptors become readable and when times come; an exception of a callback ends ``run``."""

    def __init__(self) -> None:
        self._timers: list[tuple[int, int, Timer]] = []
        self._sequence = 0
        self._readers: dict[int, Callable[[], None]] = {}
        self._stopping = False
        self._rested_ns = 0
        self._serve: Serve | None = None
        self._waker = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self.add_reader(self._waker, self._drain_waker)

    def now_ns(self) -> int:
        """The loop's time."""
        return time.monotonic_ns()

    def end_ns(self, for_s: float | None) -> float:
        """When it is over what begins now and lasts so long; None is for ever."""
        return math.inf if for_s is None else self.now_ns() + for_s * 1e9

    def add_reader(self, fileno: int, callback: Callable[[], None]) -> None:
        """Call `callback` whenever descriptor `fileno` is readable; replaces the one it had."""
        self._readers[fileno] = callback

    def remove_reader(self, fileno: int) -> None:
        """Forget descriptor `fileno`; does no harm if it isn't known."""
        self._readers.pop(fileno, None)

    def serve_by(self, serve: Serve) -> None:
        """Have somebody wait, and do what is his own meanwhile, until there is something to serve, or sooner.

        He returns when he had nothing to do last (0: he does not know).
        """
        self._serve = serve

    def call_at(self, time_ns: int, callback: Callable[[], None]) -> Timer:
        """Call `callback` once at `time_ns` or soon after, in the order of time, the same times as they were asked for.

        That holds for times which have passed too: who comes late, and asks for the past, sees all in its order.
        """
        timer = Timer(time_ns, callback)
        self._sequence += 1
        heapq.heappush(self._timers, (time_ns, self._sequence, timer))
        return timer

    def stop(self) -> None:
        """Make ``run`` return, at once if it isn't running yet; may be called by a signal handler or a thread."""
        self._stopping = True
        if self._waker in self._readers:  # a second signal may come when all is closed
            os.eventfd_write(self._waker, 1)

    def run(self, until_ns: int | None = None) -> None:
        """Serve until ``stop``, or until `until_ns` has passed; what is ready now is served in any case.

        With more to do than it can it pauses for 2 ms every 20: its process may be more urgent than those it serves.
        """
        _libc.prctl(_PR_SET_TIMERSLACK, _SLACK_NS)  # the kernel's default lets it wake this thread 50 us late
        self._rested_ns = time.monotonic_ns()
        while not self._stopping:
            # Readers come before the timers that became due meanwhile: a frame that was sent before the bus got idle
            # takes part in the arbitration.
            self._wait(self._next_ns(until_ns))
            now_ns = self.now_ns()
            self._call_due(now_ns)
            if until_ns is not None and now_ns >= until_ns:
                break
        self._stopping = False

    def close(self) -> None:
        """Let go of the loop's own descriptor; the readers' belong to who added them."""
        if self._waker in self._readers:
            self.remove_reader(self._waker)
            os.close(self._waker)

    def _next_ns(self, until_ns: int | None) -> int | None:
        timers = self._timers
        while timers and timers[0][2].callback is None:  # nobody is woken by what was cancelled
            heapq.heappop(timers)
        if not timers:
            return until_ns
        next_ns = timers[0][0]
        return next_ns if until_ns is None else min(next_ns, until_ns)

    def _call_due(self, now_ns: int) -> None:
        timers = self._timers
        while timers and timers[0][0] <= now_ns and not self._stopping:
            callback = heapq.heappop(timers)[2].callback
            if callback is not None:
                callback()

    def _wait(self, next_ns: int | None) -> None:
        if self._serve is not None:
            self._rested_ns = max(self._rested_ns, self._serve(tuple(self._readers), next_ns))
            next_ns = self._next_ns(next_ns)  # he may have set timers
        timeout_s = None if next_ns is None else max(0, next_ns - self.now_ns()) * 1e-9
        before_ns = time.monotonic_ns()
        ready = select.select(self._readers, (), (), timeout_s)[0]
        after_ns = time.monotonic_ns()
        if timeout_s != 0 and after_ns - before_ns > _RESTED_NS:
            self._rested_ns = after_ns
        elif after_ns - self._rested_ns > _BUSY_NS:
            time.sleep(_PAUSE_S)
            self._rested_ns = time.monotonic_ns()
        for fileno in ready:
            callback = self._readers.get(fileno)  # one that was called before it may have removed it
            if callback is not None:
                callback()

    def _drain_waker(self) -> None:
        os.eventfd_read(self._waker)
