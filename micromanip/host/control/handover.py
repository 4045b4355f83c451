"""An answer that comes with descriptors: the telemetry, for whoever may observe, to map for reading and nothing else.

They travel with the answer's own line, by SCM_RIGHTS. The loop does not notice who has mapped what.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from micromanip.errors import DeviceUnavailable
from micromanip.replies import Telemetry
from micromanip.rt.telemetry import ROW

from ..controller import Controller
from ..shared_memory import CONTROL, STATUS, columns


@dataclass(frozen=True)
class Handed:
    """A result, and descriptors that go with it; they are the server's to close."""

    result: Any
    descriptors: tuple[int, ...]

    @contextlib.contextmanager
    def held(self) -> Iterator[tuple[int, ...]]:
        """The descriptors, closed afterwards."""
        try:
            yield self.descriptors
        finally:
            for descriptor in self.descriptors:
                os.close(descriptor)


def telemetry(controller: Controller) -> Handed:
    """Read-only descriptors of the loop's status, its ring and its parameters, in this order, and what they hold."""
    configuration = controller.prepared.configuration
    segments = controller.segments
    limiters = controller.prepared.parameters[0]["axis"]["limiter"]
    told = Telemetry(
        axes=list(configuration.axes),
        drivers=list(configuration.drivers),
        range_V={
            axis: [float(limiters[i]["low_V"]), float(limiters[i]["high_V"])]
            for i, axis in enumerate(configuration.axes)
        },
        period_ns=configuration.loop.period_ns,
        status_bytes=STATUS.itemsize,
        row_bytes=ROW.itemsize,
        control_bytes=CONTROL.itemsize,
        columns=columns(),
    )
    found: list[int] = []
    try:
        found += [segments.status.read_only()]
        found += [segments.ring.read_only()]
        found += [segments.control.read_only()]
    except OSError:
        for descriptor in found:
            os.close(descriptor)
        raise
    return Handed(told, tuple(found))


def send(connection: Any, line: bytes, descriptors: tuple[int, ...]) -> None:
    """Send `line` with `descriptors` on the socket of a transport that has nothing else to send.

    Raises DeviceUnavailable where the client has left too much unread to take it in one piece.
    """
    with socket.socket(fileno=os.dup(connection.fileno())) as own:  # a transport's socket has no sendmsg
        try:
            sent = socket.send_fds(own, [line], descriptors)
        except BlockingIOError:
            sent = 0
    if sent != len(line):
        raise DeviceUnavailable("the client takes no answers")
