"""UDP datagrams, to and from one device."""

from __future__ import annotations

import socket

from ..kernel_times import ANCILLARY_BYTES, KernelTimes
from .port import Port
from .port_options import UdpPort


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
