"""A TCP connection to the device."""

from __future__ import annotations

import os
import socket
import time

from .port import Port
from .port_options import TcpPort

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
