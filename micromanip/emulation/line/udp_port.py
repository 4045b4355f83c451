"""A UDP port that an emulated device sends from and receives at."""

from __future__ import annotations

import contextlib
import socket

from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop

from .port import Hear, SocketPort

_READ_BYTES = 65536
_OVERHEAD_BYTES = 66
"""Ethernet with its gap, IP and UDP."""


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
            raise DeviceUnavailable(
                f"{self.name} can't be opened: {error.strerror}; devices are emulated at an address of this "
                "machine, on a port that is free"
            ) from error
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
        if self.echo:
            self.send(data)
        if data:
            self._hear(data, self)

    def _count(self, count: int) -> None:
        if count:
            self.figures.busy_ns += round((count + _OVERHEAD_BYTES) * self._byte_ns)
