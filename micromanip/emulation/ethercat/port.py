"""The slaves' end of a veth pair, whose other end a master opens; the pair is made if it is not there."""

from __future__ import annotations

import contextlib
import socket
import subprocess
from pathlib import Path

from micromanip.bus.ethercat.registers import ETHERTYPE
from micromanip.emulation.line.port import Hear, SocketPort
from micromanip.errors import DeviceUnavailable
from micromanip.rt.io.context import SO_TIMESTAMPNS
from micromanip.testbus.event_loop import EventLoop

_READ_BYTES = 2048
_WIRE_BYTES, _BYTE_NS = 24, 80
"""Of each frame besides its own, and what a byte takes at 100 Mbit/s."""
_NETWORKS, _IPV6 = Path("/sys/class/net"), Path("/proc/sys/net/ipv6/conf")
_FAR_END = "-far"
_LONGEST_NAME = 15


class EthernetPort(SocketPort):
    """Hears frames at the far end of the interface that the master's configuration names."""

    def __init__(self, loop: EventLoop, interface: str, hear: Hear) -> None:
        """Raises DeviceUnavailable where the pair can't be made or opened."""
        super().__init__(loop, hear)
        self._interface = interface
        self._made = not (_NETWORKS / interface).is_dir()
        if self._made:
            _make_pair(interface)
        try:
            self.plug_in()
        except BaseException:
            self.close()
            raise

    @property
    def name(self) -> str:
        return f"ethercat {self._interface}"

    def carried(self, frames: int, length: int) -> None:
        """Frames, of so many bytes together, that went there and back another way than through this object."""
        self.figures.bytes_received += length
        self.figures.bytes_sent += length
        self.figures.busy_ns += (length + frames * _WIRE_BYTES) * _BYTE_NS

    def send(self, data: bytes) -> None:
        """One frame."""
        with contextlib.suppress(OSError):  # the interface is down
            if self._socket is not None:
                self.figures.bytes_sent += self._socket.send(data)

    def _opened(self) -> socket.socket:
        far = _far_end(self._interface)
        try:
            opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)  # nothing comes before it is bound
        except OSError as problem:
            raise _unavailable(self._interface, problem) from problem
        try:
            opened.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            opened.setblocking(False)
            opened.bind((far, ETHERTYPE))
        except OSError as problem:
            opened.close()
            raise _unavailable(self._interface, problem) from problem
        return opened

    def close(self) -> None:
        self.unplug()
        if self._made:
            _ip("link", "del", self._interface)

    def read(self) -> None:
        """Take one frame in."""
        assert self._socket is not None
        try:
            data = self._socket.recv(_READ_BYTES)
        except OSError:
            return  # the interface has gone down, which is told once
        self.figures.bytes_received += len(data)
        self.figures.busy_ns += (len(data) + _WIRE_BYTES) * _BYTE_NS
        self._hear(data, self)


def _make_pair(interface: str) -> None:
    far = interface[: _LONGEST_NAME - len(_FAR_END)] + _FAR_END
    if refused := _ip("link", "add", interface, "type", "veth", "peer", "name", far):
        raise DeviceUnavailable(
            f"ethercat {interface} is not there, and no veth pair can be made for it: {refused}; as root: "
            f"ip link add {interface} type veth peer name {far}"
        )
    for end in (interface, far):
        with contextlib.suppress(OSError):  # a kernel without IPv6 sends nothing of its own
            (_IPV6 / end / "disable_ipv6").write_text("1", encoding="ascii")
        _ip("link", "set", end, "up")


def _ip(*arguments: str) -> str:
    """What the command `ip` says against it; nothing if it was done."""
    try:
        done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    except OSError as problem:
        return f"the command ip can't be run: {problem.strerror}"
    return done.stderr.strip() if done.returncode else ""


def _far_end(interface: str) -> str:
    """The other end of a veth pair. Raises DeviceUnavailable for any other kind of interface."""
    try:
        near = int((_NETWORKS / interface / "ifindex").read_text(encoding="ascii"))
        far = int((_NETWORKS / interface / "iflink").read_text(encoding="ascii"))
        if far != near:
            return socket.if_indextoname(far)
    except (OSError, ValueError):
        pass
    raise DeviceUnavailable(f"ethercat {interface} is no veth pair: terminals are emulated on the far end of one only")


def _unavailable(interface: str, problem: OSError) -> DeviceUnavailable:
    return DeviceUnavailable(
        f"ethercat {interface} can't be opened: {problem.strerror}; raw frames need root or CAP_NET_RAW"
    )
