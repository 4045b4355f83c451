"""What the host and a process of its own tell each other: a JSON document a line.

Its standard input brings orders, and the end of it is the end; its standard output says what became of them.

One that runs already, and began to import before the host knew what to order, gets one document for good on a socket
that is its standard input, with open files along (SCM_RIGHTS, unix(7)). Both ends have the very same open files then:
shared memory, and locks that hold until the last of the two lets go.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

_BYTES, _DESCRIPTORS = 65_536, 253
"""Read at once; and the most that Linux lets go along."""


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


def first_orders() -> tuple[Orders, Any]:
    """Orders of the host on standard input, and the first of them: None where it died as it started this process.

    What a service's processes are all sent does not end this one: the host does.
    """
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    told = Orders(sys.stdin.fileno())
    return told, told.next()


def send_orders(wire: socket.socket, orders: Any, descriptors: Sequence[int]) -> None:
    """All orders that there will ever be; raises OSError where nobody is there to take them."""
    document = json.dumps(orders).encode()
    sent = socket.send_fds(wire, [document], list(descriptors))
    wire.sendall(document[sent:])
    wire.shutdown(socket.SHUT_WR)


def receive_orders(standard_input: int = 0) -> tuple[Any, list[int]]:
    """What the host handed on, as soon as it does: orders and descriptors. None where it ended, or let go, before."""
    with socket.socket(fileno=os.dup(standard_input)) as wire:
        document, descriptors, _, _ = socket.recv_fds(wire, _BYTES, _DESCRIPTORS)
        while more := wire.recv(_BYTES):
            document += more
    return (json.loads(document) if document else None), descriptors
