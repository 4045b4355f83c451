"""Any interface of python-can: the library's own ``recv`` and ``send``, each in a thread of its own.

Nothing is trusted of a library of others: it may sleep while it opens, block in a send whose time-out is 0, wait in
``recv`` for as long as it likes, raise what it never said. What it does holds up nobody but itself, and shows as frames
that are missing, as an error, or as a lost link. Frames are stamped as they are read.
"""

from __future__ import annotations

import contextlib
import os
import termios
import threading
import time
from collections import deque
from collections.abc import Callable

import can

from micromanip.driver import StillOpening

FRAMES_PER_S, FRAMES_PER_S_OF = 8000.0, {"slcan": 2000.0}
"""What the threads bear in both directions together, with all else that a worker does; and where a library is slow."""

_RECEIVE_S, _SEND_S = 0.05, 1.0
_FULL_NS, _STUCK_NS = 50_000_000, 500_000_000
"""A frame that has waited so long is not added to: values would grow old; a send that takes so long is a lost link."""
_ROOM, _QUEUE = 64, 4096
_OPEN_S, _LONGEST_OPEN_S = 0.25, 60.0
_FAILURES = 10
"""Failures of ``recv`` one after the other that end it; a bad frame is one, a port that is gone is many."""
_END_S = 0.3


class Stuck(Exception):  # noqa: N818 (it says what happened)
    """The library does not come back from a send."""


class ThreadedBus:
    """The bus that ``opens()`` brings, and its two threads."""

    def __init__(self, opens: Callable[[], can.BusABC]) -> None:
        self._opens = opens
        self._began = time.monotonic()
        self._changed = threading.Condition()
        self._received: deque[tuple[can.Message, int]] = deque()
        self._to_send: deque[tuple[can.Message, int]] = deque()
        self._sending_since_ns = 0
        self._bus: can.BusABC | None = None
        self._failure: Exception | None = None
        self._unsent: Exception | None = None
        self._ends = False
        self.is_gone = False
        """Whether the library has let go of the device."""
        self.overflows = self.bad_frames = self.frames_out = 0
        threading.Thread(target=self._live, daemon=True).start()

    def reach(self) -> None:
        """Wait a moment until it is open. Raises StillOpening, or whatever the library did."""
        with self._changed:
            self._changed.wait_for(lambda: self._bus is not None or self._failure is not None, _OPEN_S)
            if self._failure is not None:
                raise self._failure
            for_s = time.monotonic() - self._began
        if self._bus is None:
            if for_s > _LONGEST_OPEN_S:
                raise OSError(f"the library has not opened it within {for_s:.0f} s")
            raise StillOpening(f"the library has been opening it for {for_s:.1f} s")

    def send(self, message: can.Message) -> None:
        """Hand over a frame. Raises BlockingIOError where one still waits, Stuck, or whatever the library did before.

        What the library does to this one shows by the next call.
        """
        with self._changed:
            self._judge()
            unsent, self._unsent = self._unsent, None
            if unsent is not None:
                raise unsent
            now_ns = time.monotonic_ns()
            oldest_ns = self._sending_since_ns or (self._to_send[0][1] if self._to_send else now_ns)
            if now_ns - oldest_ns > _FULL_NS or len(self._to_send) >= _ROOM:
                raise BlockingIOError("its transmit buffer is full: a frame still waits to be taken")
            self._to_send.append((message, now_ns))
            self._changed.notify_all()

    def wait(self, seconds: float) -> None:
        """Until a frame is there, or so long."""
        with self._changed:
            self._changed.wait_for(lambda: self._received or self._failure is not None, seconds)

    def drain(self, limit: int) -> list[tuple[can.Message, int]]:
        """What is there, `limit` frames at most, each with its time. Raises Stuck, or whatever the library did."""
        with self._changed:
            if not self._received:
                self._judge()
            return [self._received.popleft() for _ in range(min(limit, len(self._received)))]

    def close(self) -> None:
        """Let what was sent last go out, and the library let go of the device, if both take no longer than a moment."""
        with self._changed:
            self._changed.wait_for(lambda: self._failure is not None or self._is_idle(), _END_S)
            is_stuck = not self._is_idle()
            self._ends = True
            self._to_send.clear()
            self._changed.notify_all()
            if is_stuck and self._bus is not None:
                _discard_output(self._bus)  # what an adapter has not read must not move anything later
            if self._changed.wait_for(lambda: self.is_gone, _END_S) or self._bus is None:
                return
        threading.Thread(target=self._shut, args=(self._bus,), daemon=True).start()  # it may come back by that
        with self._changed:
            self._changed.wait_for(lambda: self.is_gone, _END_S)

    def _shut(self, bus: can.BusABC) -> None:
        with contextlib.suppress(Exception):
            bus.shutdown()
        with self._changed:
            self.is_gone = True
            self._changed.notify_all()

    def _is_idle(self) -> bool:
        return not self._to_send and not self._sending_since_ns

    def _judge(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._sending_since_ns and (for_ns := time.monotonic_ns() - self._sending_since_ns) > _STUCK_NS:
            raise Stuck(f"it has not taken a frame for {for_ns * 1e-6:.0f} ms")

    def _fail(self, error: Exception) -> None:
        with self._changed:
            self._failure = self._failure or error
            self._to_send.clear()
            self._changed.notify_all()

    def _live(self) -> None:
        """Open, receive until the end, close: whatever of it takes how long."""
        bus, sending = None, threading.Thread(target=self._send_all, daemon=True)
        try:
            bus = self._opens()
            with self._changed:
                self._bus = bus
                self._changed.notify_all()
            sending.start()
            self._receive_all(bus)
        except Exception as error:
            self._fail(error)
        if bus is None:
            self.is_gone = True
            return
        with self._changed:
            self._changed.wait_for(lambda: self._ends)
        sending.join()
        if not self.is_gone:
            self._shut(bus)

    def _receive_all(self, bus: can.BusABC) -> None:
        failures = 0
        while not self._ends:
            try:
                message = bus.recv(_RECEIVE_S)
            except Exception as error:
                failures += 1
                if failures >= _FAILURES:
                    raise
                self.bad_frames += 1
                if failures > 1 or isinstance(error, UnicodeError):
                    _discard_input(bus)
                time.sleep(1e-3 * failures)
                continue
            failures = 0
            if message is not None:
                with self._changed:
                    if len(self._received) >= _QUEUE:
                        self._received.popleft()
                        self.overflows += 1
                    self._received.append((message, time.monotonic_ns()))
                    self._changed.notify_all()

    def _send_all(self) -> None:
        bus = self._bus
        assert bus is not None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ends or self._to_send)
                if self._ends:
                    return
                message, _ = self._to_send.popleft()
                self._sending_since_ns = time.monotonic_ns()
            error: Exception | None = None
            try:
                bus.send(message, timeout=_SEND_S)
            except Exception as problem:
                error = problem
            with self._changed:
                self._sending_since_ns = 0
                self._unsent = error or self._unsent
                self.frames_out += error is None
                self._changed.notify_all()


def _discard_input(bus: can.BusABC) -> None:
    """Have the library forget what it has read of a frame: some keep a bad one for ever."""
    for name in ("flush", "flush_buffer"):
        if callable(flush := getattr(bus, name, None)):
            with contextlib.suppress(Exception):
                flush()


def _discard_output(bus: can.BusABC) -> None:
    """Drop what a serial port has not sent, which also ends a send that waits for it."""
    with contextlib.suppress(Exception):
        if os.isatty(descriptor := bus.fileno()):
            termios.tcflush(descriptor, termios.TCOFLUSH)
