"""What a emulated device on a line of its own needs of a port, be it serial, TCP or UDP."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol


@dataclass
class LineFigures:
    """Since the start."""

    bytes_sent: int = 0
    bytes_received: int = 0
    bytes_lost: int = 0
    """Sent while nobody had the port open, or faster than they were read."""
    busy_ns: int = 0
    """Time on the line, both directions together."""


class Peer(Protocol):
    """Whoever an answer goes to."""

    def send(self, data: bytes) -> None:
        """Send it one message; lost if it has gone."""


class LinePort(Peer, Protocol):
    """The device's end of a line; what is sent to the port itself goes to all that are connected."""

    figures: LineFigures
    echo: bool
    """Whether what is received goes back to its sender, as it does where the receiver of an RS-485 pair stays on."""

    @property
    def name(self) -> str:
        """As it is called: "serial /dev/ttyUSB0, 115200 baud", "tcp 127.0.0.1:50000"."""

    def unplug(self) -> None:
        """Break all connections; none can be made before ``plug_in``."""

    def plug_in(self) -> None:
        """Be there again, under the same name."""

    def close(self) -> None:
        """Be gone for good."""


Hear = Callable[[bytes, Peer], None]
"""Takes what came, and who may be answered; no bytes at all mean that this peer has gone."""
