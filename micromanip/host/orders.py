"""What the host and a process of its own tell each other: a JSON document a line.

Its standard input brings orders, and the end of it is the end; its standard output says what became of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
from collections import deque
from typing import Any

_BYTES = 65_536


def send_message(**message: Any) -> None:
    """A line for the host, which may be dead: what is on disk stays, and becomes complete all the same."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), json.dumps(message).encode() + b"\n")


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
