"""What a process and the host that has started it tell each other, a JSON document a line.

Its standard input brings orders, and the end of it is the end; its standard output says what became of them. A worker
tells what happens, and now and then what it has counted.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

_BYTES = 65_536
"""Read at once."""

_EVERY_NS = 500_000_000
_COUNTERS = ("received", "lost", "performed", "held", "errors", "refused", "links", "skipped")


class Report:
    """The worker's own counters, and when they are due to be told."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(_COUNTERS, 0)
        self._told_ns = 0

    @property
    def due_ns(self) -> int:
        """When they are to be told next."""
        return self._told_ns + _EVERY_NS

    def tell_counts(self, now_ns: int, of_driver: Mapping[str, int]) -> None:
        """The worker's and the driver's counters, and what of a CPU was used.

        A name that both have is the worker's: `lost`, in samples of all inputs as `received` is, not in frames.
        """
        self._told_ns = now_ns
        counts = {**of_driver, **self.counts}
        send_message(event="statistics", counts=counts, cpu_s=round(time.process_time(), 3))


def tell(event: str, text: str, **more: Any) -> None:
    """Something has happened."""
    send_message(event=event, text=text, **more)


def send_message(**message: Any) -> None:
    """A line for the host, which may be dead, or not listen fast enough: what else there is to do comes first."""
    with contextlib.suppress(OSError):
        os.write(1, json.dumps(message).encode() + b"\n")


class Orders:
    """Lines of a descriptor, as they come."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._partial = b""
        self._ready: deque[Any] = deque()
        self.ended = False

    def next(self) -> Any:
        """The next order, however long it takes; None at the end."""
        while not self._ready and not self.ended:
            self._read()
        return self._ready.popleft() if self._ready else None

    def within(self, seconds: float) -> list[Any]:
        """What is ordered now; where there is nothing, what comes first within `seconds`."""
        if not self._ready and not self.ended and select.select([self._descriptor], [], [], seconds)[0]:
            self._read()
        found = list(self._ready)
        self._ready.clear()
        return found

    def _read(self) -> None:
        some = os.read(self._descriptor, _BYTES)
        self.ended = not some
        *lines, self._partial = (self._partial + some).split(b"\n")
        self._ready.extend(json.loads(line) for line in lines if line)


def first_orders() -> tuple[Orders, Any]:
    """Orders of the host on standard input, and the first of them: None where it died as it started this process.

    What a service's processes are all sent does not end this one: the host does.
    """
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    told = Orders(0)
    return told, told.next()
