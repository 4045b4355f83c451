"""What an emulated device on a line of its own needs of a port: serial, TCP, UDP or Ethernet; those of a network."""

from __future__ import annotations

import contextlib
import socket
import struct
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from micromanip.bus.datagram_socket import lend
from micromanip.errors import DeviceUnavailable
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
        self.figures = LineFigures()
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


_READ_BYTES = 65536
_OVERHEAD_BYTES = 66
"""Ethernet with its gap, IP and UDP."""


def _unavailable(port: LinePort, error: OSError) -> DeviceUnavailable:
    return DeviceUnavailable(
        f"{port.name} can't be opened: {error.strerror}; devices are emulated at an address of this machine, on a port "
        "that is free"
    )


class UdpPort(SocketPort):
    """The device's end: it sends to where the controller listens, or to who has asked last."""

    def __init__(
        self, loop: EventLoop, host: str, port: int, listener: int | None, hear: Hear, bits_per_s: float
    ) -> None:
        """`listener` is the controller's port, at the same address: all of it is on this machine.

        Raises DeviceUnavailable for an address that is in use, or that this machine doesn't have.
        """
        super().__init__(loop, hear)
        self._address = host, port
        self._byte_ns = 8e9 / bits_per_s
        self._configured = None if listener is None else (host, listener)
        self._to = self._configured
        self._stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._stranger.setblocking(False)
        try:
            self.plug_in()
        except BaseException:
            self._stranger.close()
            raise

    @property
    def name(self) -> str:
        return f"udp {self._address[0]}:{self._address[1]}"

    def carried(self, sent: int, sent_bytes: int, received: int, received_bytes: int) -> None:
        """Datagrams, of so many bytes each, that went another way than through this object."""
        self.figures.bytes_sent += sent * sent_bytes
        self.figures.bytes_received += received * received_bytes
        for count, length in ((sent, sent_bytes), (received, received_bytes)):
            self.figures.busy_ns += count * round((length + _OVERHEAD_BYTES) * self._byte_ns)

    def send(self, data: bytes) -> None:
        """One datagram."""
        if self._socket is not None:
            self._send_from(self._socket, data)

    def send_as_stranger(self, data: bytes) -> None:
        """The same from a port that is not the device's."""
        self._send_from(self._stranger, data)

    def _opened(self) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.bind(self._address)
        except OSError as error:
            opened.close()
            raise _unavailable(self, error) from error
        return opened

    def unplug(self) -> None:
        super().unplug()
        self._to = self._configured

    def close(self) -> None:
        self.unplug()
        self._stranger.close()

    def _send_from(self, sender: socket.socket, data: bytes) -> None:
        sent = 0
        if self._to is not None:
            with contextlib.suppress(OSError):  # nobody listens there, or not fast enough
                sent = sender.sendto(data, self._to)
        self.figures.bytes_sent += sent
        self.figures.bytes_lost += len(data) - sent
        self._count(sent)

    def read(self) -> None:
        """Take one datagram in."""
        assert self._socket is not None
        try:
            data, sender = self._socket.recvfrom(_READ_BYTES)
        except OSError:
            return  # an answer of the system to what was sent to nobody
        self.figures.bytes_received += len(data)
        self._count(len(data))
        if self._configured is None:
            self._to = sender
        if data:
            self._hear(data, self)

    def _count(self, count: int) -> None:
        if count:
            self.figures.busy_ns += round((count + _OVERHEAD_BYTES) * self._byte_ns)


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
        self.figures = LineFigures()
        self._loop, self._address, self._hear = loop, (host, port), hear
        self._byte_ns = 8e9 / bits_per_s
        self._listener: socket.socket | None = None
        self._connections: dict[int, TcpConnection] = {}
        self.plug_in()

    @property
    def name(self) -> str:
        return f"tcp {self._address[0]}:{self._address[1]}"

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
            raise _unavailable(self, error) from error
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
        self._hear(data, connection)

    def _drop(self, connection: TcpConnection, *, reset: bool) -> None:
        self._loop.remove_reader(connection.fileno())
        del self._connections[connection.fileno()]
        connection.close(reset=reset)
        self._hear(b"", connection)
