"""A serial port whose far end is an emulated device: a pseudo terminal, with a link to it at the configured path.

What a pseudo terminal has not by itself comes from here: bytes take their time on the line, and those that are sent
while nobody has the port open are lost. At which rate a program opens it makes no difference.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import tty
from collections.abc import Callable
from pathlib import Path

from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop

from .port import LineFigures, LinePort

_READ_BYTES = 65536
_LOOK_EVERY_NS = 5_000_000
"""How often a port that nobody has open is looked at."""


class PseudoTerminal(LinePort):
    """The far end of a serial port. `on_received` gets bytes when the last of them has come over the line."""

    def __init__(
        self,
        loop: EventLoop,
        device: Path,
        baud: int,
        on_received: Callable[[bytes], None],
        *,
        bits_per_byte: int = 10,
        half_duplex: bool = False,
    ) -> None:
        """The port `device` at `baud`; a byte takes `bits_per_byte`, with start and stop bits and parity.

        With `half_duplex` both directions take turns on one pair of wires, as RS-485 does.
        Raises DeviceUnavailable where no link can be put at `device`: a real port is there, or one that is simulated.
        """
        self.device, self.figures = device, LineFigures()
        self.echo = False
        self._loop, self._baud, self._on_received = loop, baud, on_received
        self._byte_ns = bits_per_byte * 1e9 / baud
        self._half_duplex = half_duplex
        self._free_ns = {"sent": 0, "received": 0}
        self._master: int | None = None
        self._name = ""
        self._owner = _claim(device)
        try:
            self.plug_in()
        except BaseException:
            self._owner.close()
            raise

    @property
    def name(self) -> str:
        return f"serial {self.device}, {self._baud} baud"

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._master is not None

    def send(self, data: bytes) -> None:
        """Put bytes on the line; they arrive together when the last one has."""
        if self.plugged and data:
            self._loop.call_at(self._over_the_line("sent", len(data)), lambda: self._arrive(data))

    def unplug(self) -> None:
        """Take the port away, as a USB adapter that is pulled: who has it open reads an end of file."""
        if self._master is None:
            return
        self._loop.remove_reader(self._master)
        os.close(self._master)
        self._master = None
        if _target(self.device) == self._name:
            self.device.unlink()

    def plug_in(self) -> None:
        """Bring it back, under the same name. Raises DeviceUnavailable as at the beginning."""
        if self._master is not None:
            return
        _make_way(self.device)
        master, slave = os.openpty()
        try:
            tty.setraw(slave)
            self._name = os.ttyname(slave)
            os.set_blocking(master, False)
            _link(self.device, self._name)
        except BaseException:
            os.close(master)
            raise
        finally:
            os.close(slave)
        self._master = master
        self._look_for_client()

    def close(self) -> None:
        """Take the port away for good."""
        self.unplug()
        self._owner.close()

    def _look_for_client(self) -> None:
        """The descriptor of a port that nobody has open is always readable, so it is looked at now and then."""
        if self._master is None:
            return
        if _hung_up(self._master):
            self._loop.call_at(self._loop.now_ns() + _LOOK_EVERY_NS, self._look_for_client)
        else:
            self._loop.add_reader(self._master, self._read)

    def _read(self) -> None:
        assert self._master is not None
        try:
            data = os.read(self._master, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._loop.remove_reader(self._master)
            self._look_for_client()
            return
        self._loop.call_at(self._over_the_line("received", len(data)), lambda: self._hear(data))

    def _hear(self, data: bytes) -> None:
        if self._master is not None:
            self.figures.bytes_received += len(data)
            if self.echo:
                self._write(data)
            self._on_received(data)

    def _arrive(self, data: bytes) -> None:
        if self._master is None:
            return
        self.figures.bytes_sent += len(data)
        self._write(data)

    def _write(self, data: bytes) -> None:
        assert self._master is not None
        written = 0
        if not _hung_up(self._master):
            with contextlib.suppress(BlockingIOError):
                written = os.write(self._master, data)
        self.figures.bytes_lost += len(data) - written

    def _over_the_line(self, direction: str, count: int) -> int:
        """When the last of `count` bytes has passed."""
        duration_ns = round(count * self._byte_ns)
        self.figures.busy_ns += duration_ns
        free_ns = max(self._free_ns.values()) if self._half_duplex else self._free_ns[direction]
        self._free_ns[direction] = max(free_ns, self._loop.now_ns()) + duration_ns
        return self._free_ns[direction]


def _claim(device: Path) -> socket.socket:
    """The right to play a path, held by an abstract socket: it ends with the process, however that ends."""
    owner = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        owner.bind(f"\0micromanip-serial-{device.absolute()}")
    except OSError as error:
        owner.close()
        raise DeviceUnavailable(
            f"serial port {device} is simulated by another process already; stop it, or choose another path"
        ) from error
    return owner


def _make_way(device: Path) -> None:
    """Remove what a process that was killed left there; nothing else."""
    target = _target(device)
    if target is not None and target.startswith("/dev/pts/"):
        device.unlink()
    elif target is not None or device.exists():
        raise DeviceUnavailable(
            f"serial port {device} exists, and is never replaced by a simulated one; choose another path for it"
        )


def _link(device: Path, target: str) -> None:
    try:
        device.symlink_to(target)
    except OSError as error:
        raise DeviceUnavailable(
            f"serial port {device} can't be made: {error.strerror}; choose a path in a folder that exists and that "
            "you may write to"
        ) from error


def _target(device: Path) -> str | None:
    return str(device.readlink()) if device.is_symlink() else None


def _hung_up(master: int) -> bool:
    """Whether nobody has the other end open."""
    poll = select.poll()
    poll.register(master, 0)
    return bool(poll.poll(0))
