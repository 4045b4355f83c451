"""What an emulated device on a line of its own needs of a port, be it serial, TCP, UDP or Ethernet."""

from __future__ import annotations

import socket
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from micromanip.bus.datagram_socket import lend
from micromanip.testbus.event_loop import EventLoop


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


class SocketPort(LinePort):
    """A port with one socket of datagrams or frames, which compiled code may serve in between."""

    def __init__(self, loop: EventLoop, hear: Hear) -> None:
        self.figures, self.echo = LineFigures(), False
        self._loop, self._hear = loop, hear
        self._socket: socket.socket | None = None
        self._is_lent = False

    @abstractmethod
    def _opened(self) -> socket.socket:
        """A socket that is bound. Raises DeviceUnavailable."""

    @abstractmethod
    def read(self) -> None:
        """Take one datagram in."""

    def plug_in(self) -> None:
        if self._socket is None:
            self._socket = self._opened()
            self._loop.add_reader(self._socket.fileno(), self.read)

    def unplug(self) -> None:
        """Nothing comes and nothing arrives; who asks is told by the system that nobody listens."""
        if self._socket is not None:
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()
            self._socket, self._is_lent = None, False

    def lend(self, record: Any, serve: Callable[[], None]) -> bool:
        """Let compiled code have a socket by its `record`: `serve` is called where something comes.

        True where it was opened since the call before.
        """
        if self._socket is None or self._is_lent:
            return False
        lend(self._socket.fileno(), record)
        self._loop.add_reader(self._socket.fileno(), serve)
        self._is_lent = True
        return True
