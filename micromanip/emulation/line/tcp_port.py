"""A TCP port that a emulated device listens on; several programs may be connected at a time."""

from __future__ import annotations

import contextlib
import socket
import struct

from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop

from .port import Hear, LineFigures, LinePort, Peer

_READ_BYTES = 65536
_BACKLOG = 8
_RESET = struct.pack("=ii", 1, 0)
_SEND_BUFFER_BYTES = 65536
"""As much as a small device has: a reader that stands still loses packets, it does not get all of them later."""


class TcpConnection(Peer):
    """One program that is connected."""

    def __init__(self, link: socket.socket, port: TcpPort) -> None:
        self._link, self._port = link, port
        self._rest = b""
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)

    def fileno(self) -> int:
        """Of its socket."""
        return self._link.fileno()

    def send(self, data: bytes) -> None:
        """Whole, or not at all while there is no room: the rest of a message that was begun goes before the next."""
        if self._rest:
            self._port.figures.bytes_lost += len(data)
        pending = self._rest or data
        try:
            sent = self._link.send(pending)
        except BlockingIOError:
            sent = 0
        except OSError:
            return  # it has gone, as the reader finds out
        self._port.sent(sent)
        self._rest = pending[sent:]

    def receive(self) -> bytes:
        """What has come; nothing at all if it has gone."""
        try:
            return self._link.recv(_READ_BYTES)
        except OSError:
            return b""

    def close(self, *, reset: bool) -> None:
        """End it: in order, or as a cable that breaks and a device that knows nothing of the connection any more."""
        if reset:
            self._link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        self._link.close()


class TcpPort(LinePort):
    """The device's end."""

    def __init__(self, loop: EventLoop, host: str, port: int, hear: Hear, bits_per_s: float) -> None:
        """Listens at once; `bits_per_s` is the network's, for the figures.

        Raises DeviceUnavailable for an address that is in use, or that this machine doesn't have.
        """
        self.figures, self.echo = LineFigures(), False
        self._loop, self._address, self._hear = loop, (host, port), hear
        self._byte_ns = 8e9 / bits_per_s
        self._listener: socket.socket | None = None
        self._connections: dict[int, TcpConnection] = {}
        self.plug_in()

    @property
    def name(self) -> str:
        return f"tcp {self._address[0]}:{self._address[1]}"

    @property
    def connections(self) -> int:
        """How many programs are connected."""
        return len(self._connections)

    def send(self, data: bytes) -> None:
        for connection in list(self._connections.values()):
            connection.send(data)
        if not self._connections:
            self.figures.bytes_lost += len(data)

    def sent(self, count: int) -> None:
        """Count bytes that went out."""
        self.figures.bytes_sent += count
        self.figures.busy_ns += round(count * self._byte_ns)

    def plug_in(self) -> None:
        if self._listener is not None:
            return
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setblocking(False)
            listener.bind(self._address)
            listener.listen(_BACKLOG)
        except OSError as error:
            listener.close()
            raise DeviceUnavailable(
                f"{self.name} can't be listened on: {error.strerror}; devices are emulated at an address of this "
                "machine, on a port that is free"
            ) from error
        self._listener = listener
        self._loop.add_reader(listener.fileno(), self._accept)

    def unplug(self) -> None:
        """Connections break, and new ones are refused."""
        if self._listener is not None:
            self._loop.remove_reader(self._listener.fileno())
            self._listener.close()
            self._listener = None
        self.disconnect()

    def disconnect(self, *, reset: bool = True) -> None:
        """Break the connections that there are; others may be made at once."""
        for connection in list(self._connections.values()):
            self._drop(connection, reset=reset)

    def close(self) -> None:
        self.disconnect(reset=False)
        self.unplug()

    def _accept(self) -> None:
        assert self._listener is not None
        with contextlib.suppress(OSError):  # who called may have gone already
            link, _ = self._listener.accept()
            connection = TcpConnection(link, self)
            fileno = connection.fileno()
            self._connections[fileno] = connection
            self._loop.add_reader(fileno, lambda: self._read(connection))

    def _read(self, connection: TcpConnection) -> None:
        data = connection.receive()
        if not data:
            self._drop(connection, reset=False)
            return
        self.figures.bytes_received += len(data)
        self.figures.busy_ns += round(len(data) * self._byte_ns)
        if self.echo:
            connection.send(data)
        self._hear(data, connection)

    def _drop(self, connection: TcpConnection, *, reset: bool) -> None:
        self._loop.remove_reader(connection.fileno())
        del self._connections[connection.fileno()]
        connection.close(reset=reset)
        self._hear(b"", connection)
