"""A TCP connection to the device, or UDP datagrams to and from it."""

from __future__ import annotations

import os
import socket
import time

from ..kernel_times import ANCILLARY_BYTES, KernelTimes
from .options import TcpPort, UdpPort
from .port import Port

_SIOCOUTQNSD = 0x894B
"""Bytes that have not been sent at all: those on their way, and not acknowledged yet, are not among them."""
_TCP_USER_TIMEOUT = 18


class TcpConnection(Port):
    """The connection that `options` name; given up when nothing is acknowledged for `silence_ms`."""

    waiting_request = _SIOCOUTQNSD

    def __init__(self, options: TcpPort, silence_ms: float) -> None:
        super().__init__(f"tcp {options.host}:{options.port}")
        self._options, self._silence_ms = options, silence_ms
        self.settle_ns = round(options.settle_ms * 1e6)
        self._socket: socket.socket | None = None

    @property
    def is_plain(self) -> bool:
        return True

    def _connect(self, deadline_ns: int) -> int:
        options = self._options
        left_s = max(0.01, (deadline_ns - time.monotonic_ns()) * 1e-9)
        try:
            connection = socket.create_connection((options.host, options.port), timeout=left_s)
        except TimeoutError as problem:
            raise TimeoutError(
                f"no answer within {left_s:.1f} s; is it switched on, is the address right?"
            ) from problem
        self._socket = connection
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a small packet goes at once
        connection.setsockopt(socket.IPPROTO_TCP, _TCP_USER_TIMEOUT, max(1, round(self._silence_ms)))
        connection.setblocking(False)
        return connection.fileno()

    def _disconnect(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _read(self, descriptor: int) -> tuple[bytes, int] | None:
        data = os.read(descriptor, self.largest)
        if not data:
            raise ConnectionResetError("the device closed the connection")
        return data, time.monotonic_ns()

    def _write(self, descriptor: int, data: bytes) -> int:  # noqa: ARG002
        assert self._socket is not None
        return self._socket.send(data)


class UdpDatagrams(Port):
    """The device that `options` name. Datagrams carry the kernel's time of their reception.

    The socket is connected: the kernel drops what others send, and tells when nobody listens at the other end. What
    came in before that, while it was only bound, is told by its sender's address.
    """

    datagrams = True

    def __init__(self, options: UdpPort) -> None:
        super().__init__(f"udp {options.host}:{options.port}")
        self._options = options
        self._socket: socket.socket | None = None
        self._peer: tuple[str, int] = ("", 0)
        self.counters["strangers"] = 0

    def _connect(self, deadline_ns: int) -> int:  # noqa: ARG002 (nobody is asked, so nobody is waited for)
        options = self._options
        family, kind, protocol, _, address = socket.getaddrinfo(options.host, options.port, type=socket.SOCK_DGRAM)[0]
        self._socket = port = socket.socket(family, kind, protocol)
        port.setblocking(False)
        self._times = KernelTimes(port)
        if options.listen is not None:
            port.bind(("", options.listen))
        port.connect(address)
        self._peer = (str(address[0]), int(address[1]))
        return port.fileno()

    def _disconnect(self) -> None:
        port, self._socket = self._socket, None
        if port is not None:
            port.close()

    def _read(self, descriptor: int) -> tuple[bytes, int] | None:  # noqa: ARG002
        assert self._socket is not None
        while True:
            try:
                data, ancillary, _, sender = self._socket.recvmsg(self.largest, ANCILLARY_BYTES)
            except BlockingIOError:
                self._times.queue_is_empty()
                return None
            received_ns = self._times.received_ns(ancillary)
            if sender[:2] == self._peer:
                return data, received_ns
            self.counters["strangers"] += 1

    def _write(self, descriptor: int, data: bytes) -> int:  # noqa: ARG002
        assert self._socket is not None
        return self._socket.send(data)
