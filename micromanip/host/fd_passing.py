"""Orders and open files for a process that runs already: it begins to import before the host knows what to order.

The orders are one JSON document on a socket that is its standard input; the descriptors go along (SCM_RIGHTS, unix(7)).
Both ends have the very same open files then: shared memory, and locks that hold until the last of the two lets go.
"""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Sequence
from typing import Any

_BYTES, _DESCRIPTORS = 65_536, 253
"""Read at once; and the most that Linux lets go along."""


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
