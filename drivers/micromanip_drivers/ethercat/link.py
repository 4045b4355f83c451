"""Datagrams to and fro over a network interface, in plain Python: for all that is not cyclic."""

from __future__ import annotations

import ctypes
import errno
import select
import socket
import struct
import time
from collections.abc import Sequence

from micromanip.driver import LinkError
from micromanip.driver.ethercat import Datagram, framed, registers, unframed

LOOP_SENDER, PYTHON_SENDER = b"\x10\x10\x10\x10\x10\x10", b"\x10\x10\x10\x10\x10\x11"
"""Whom frames name as their sender: so each of the two sockets sees its own frames only."""
_ANSWER_S, _TRIES = 0.05, 4
_SO_ATTACH_FILTER, _SO_TIMESTAMPNS = 26, 35
_QUEUE_BYTES = 64 * 1024
_LOAD_BYTE, _IF_EQUAL, _RETURN = 0x30, 0x15, 0x06


class Link:
    """A socket of its own; whoever else uses the interface is not disturbed."""

    def __init__(self, interface: str) -> None:
        """Raises LinkError."""
        self.name = f"ethercat {interface}"
        self._socket = open_interface(interface, PYTHON_SENDER)
        self._index = 0

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def exchange(self, *datagrams: Datagram) -> list[Datagram]:
        """What comes back of one frame, with the working counters; sent again when it is lost. Raises LinkError."""
        for _ in range(_TRIES):
            self._index = self._index % 255 + 1
            sent = [Datagram(d.command, d.address, d.data, 0, self._index) for d in datagrams]
            try:
                self._socket.send(framed(sent, PYTHON_SENDER))
            except OSError as problem:
                raise LinkError(f"{self.name} can't send: {problem.strerror}; is the interface up?") from problem
            if back := self._received(sent):
                return back
        raise LinkError(f"{self.name}: no frame comes back; check cable, power of the first terminal, and interface")

    def read(self, command: int, slave: int, register: int, length: int) -> Datagram:
        """A register of a slave; working counter 0 where nobody has answered. Raises LinkError."""
        return self.exchange(Datagram(command, (slave & 0xFFFF, register), bytes(length)))[0]

    def write(self, command: int, slave: int, register: int, data: bytes) -> Datagram:
        """The same the other way."""
        return self.exchange(Datagram(command, (slave & 0xFFFF, register), data))[0]

    def station_read(self, station: int, register: int, length: int) -> bytes:
        """A register of the slave with that station address, which must be there. Raises LinkError."""
        back = self.read(registers.FPRD, station, register, length)
        if back.wkc != 1:
            raise LinkError(f"{self.name}: station 0x{station:04x} does not let register 0x{register:04x} be read")
        return back.data

    def station_write(self, station: int, register: int, data: bytes) -> None:
        """Write one. Raises LinkError."""
        if self.write(registers.FPWR, station, register, data).wkc != 1:
            raise LinkError(f"{self.name}: station 0x{station:04x} does not let register 0x{register:04x} be written")

    def _received(self, sent: Sequence[Datagram]) -> list[Datagram]:
        end = time.monotonic() + _ANSWER_S
        while (left := end - time.monotonic()) > 0:
            if not select.select([self._socket], [], [], left)[0]:
                break
            try:
                frame = self._socket.recv(2048)
            except OSError:
                continue  # the interface went down: told once
            back = list(unframed(frame))
            if [(d.command, d.index, len(d.data)) for d in back] == [(d.command, d.index, len(d.data)) for d in sent]:
                return back
        return []


def open_interface(interface: str, sender: bytes) -> socket.socket:
    """A raw socket that hears frames which name `sender`. Raises LinkError, which says what is missing."""
    try:
        opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)  # nothing comes before it is bound
    except OSError as problem:
        if problem.errno in (errno.EPERM, errno.EACCES):
            raise LinkError(
                f"ethercat {interface} needs the right to send raw frames, CAP_NET_RAW: start it as root, or give the "
                "service the drop-in of docs/ethercat.md"
            ) from problem
        raise LinkError(f"ethercat {interface} can't be opened: {problem.strerror}") from problem
    try:
        _hear_only(opened, sender[-1])
        opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _QUEUE_BYTES)
        opened.bind((interface, registers.ETHERTYPE))
        opened.setblocking(False)
    except OSError as problem:
        opened.close()
        raise LinkError(f"ethercat {interface} can't be opened: {problem.strerror}") from problem
    return opened


def _hear_only(opened: socket.socket, last: int) -> None:
    """Let the kernel drop frames whose sender ends with another byte: a classic BPF program of four instructions."""
    program = [(_LOAD_BYTE, 0, 0, 11), (_IF_EQUAL, 0, 1, last), (_RETURN, 0, 0, 0xFFFF), (_RETURN, 0, 0, 0)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *each) for each in program))
    opened.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HL", len(program), ctypes.addressof(code)))
