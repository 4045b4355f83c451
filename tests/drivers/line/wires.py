"""The device's end of a port: a pseudo terminal, a TCP server, a UDP socket."""

import contextlib
import itertools
import os
import select
import socket
import tempfile
import tty
from pathlib import Path

from campaigns.fault_cells import free_port


class PtyWire:
    """A serial port, found under the same name after it was unplugged and plugged in again."""

    number = itertools.count()

    def __init__(self):
        self.path = Path(tempfile.gettempdir()) / f"tty-line-test-{os.getpid()}-{next(self.number)}"
        self.master = self.slave = None

    @property
    def options(self):
        return {"serial": {"device": str(self.path), "baud": 1_000_000}}

    def start(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self.slave))

    def kill(self):
        self.path.unlink(missing_ok=True)
        for descriptor in (self.master, self.slave):
            if descriptor is not None:
                os.close(descriptor)
        self.master = self.slave = None

    def read(self, wait_s):
        """What came; empty if nothing did."""
        if not select.select([self.master], [], [], wait_s)[0]:
            return b""
        try:
            return os.read(self.master, 65536)
        except OSError:  # nobody has the other end open
            return b""

    def write(self, data):
        with contextlib.suppress(OSError):
            os.write(self.master, data)


class TcpWire:
    """A server that talks to the newest of its clients."""

    def __init__(self):
        self.port = free_port(socket.SOCK_STREAM)
        self.server = self.client = None

    @property
    def options(self):
        return {"tcp": {"host": "127.0.0.1", "port": self.port}}

    def start(self):
        self.server = socket.create_server(("127.0.0.1", self.port))
        self.server.setblocking(False)

    def kill(self):
        for one in (self.client, self.server):
            if one is not None:
                one.close()
        self.client = self.server = None

    def read(self, wait_s):
        ready = select.select([one for one in (self.server, self.client) if one], [], [], wait_s)[0]
        if self.server in ready:
            if self.client:
                self.client.close()
            self.client = self.server.accept()[0]
            self.client.setblocking(False)
            self.client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        if self.client in ready:
            with contextlib.suppress(OSError):
                if data := self.client.recv(65536):
                    return data
            self.client.close()
            self.client = None
        return b""

    def write(self, data):
        if self.client:
            with contextlib.suppress(OSError):
                self.client.send(data)


class UdpWire:
    """Sends to a port of the controller's."""

    def __init__(self):
        self.port, self.listener = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        self.socket = None

    @property
    def options(self):
        return {"udp": {"host": "127.0.0.1", "port": self.port, "listen": self.listener}}

    def start(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", self.port))
        self.socket.setblocking(False)

    def kill(self):
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def read(self, wait_s):
        if select.select([self.socket], [], [], wait_s)[0]:
            with contextlib.suppress(OSError):
                return self.socket.recv(65536)
        return b""

    def write(self, data):
        with contextlib.suppress(OSError):
            self.socket.sendto(data, ("127.0.0.1", self.listener))
