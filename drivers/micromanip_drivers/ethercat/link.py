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
from micromanip.driver.ethercat import PROCESSED, Datagram, framed, registers, unframed

LOOP_SENDERS = b"\x10\x10\x10\x10\x10\x10", b"\x10\x10\x10\x10\x10\x12"
PYTHON_SENDERS = b"\x10\x10\x10\x10\x10\x11", b"\x10\x10\x10\x10\x10\x13"
"""Whom frames name as their sender, at the near end and at the far end of a ring: so loop and Python each see their own
frames only, and know where one was sent."""
FAR_BIT, SENDER, LAST_OF_SENDER = 0x02, 6, 11
"""What the last byte of the two differs in; the first byte of the sender in a frame, and its last."""
_ANSWER_S, _TRIES = 0.05, 4
_SO_ATTACH_FILTER, _SO_TIMESTAMPNS = 26, 35
_QUEUE_BYTES = 64 * 1024
_LOAD_BYTE, _AND, _IF_EQUAL, _RETURN = 0x30, 0x54, 0x15, 0x06


class Link:
    """A socket of its own at each end; whoever else uses the interfaces is not disturbed.

    In a ring each frame is sent at both ends. Slaves act on it once: where the ring is whole on the one that came in at
    the near end, which leaves at the far end; else on each up to where it turns back, and both together are the answer.
    """

    def __init__(self, interface: str, return_interface: str | None = None) -> None:
        """`return_interface` is the far end of a ring. Raises LinkError."""
        self.name = f"ethercat {interface}"
        self._sockets = [open_interface(interface, PYTHON_SENDERS[0])]
        self._index = 0
        self.open_behind: int | None = None
        """The ring is broken behind so many slaves, by the last BRD; None for a whole one, and for a line."""
        self.lost = 0
        """How many frames have not come back."""
        if return_interface is not None:
            try:
                self._sockets.append(open_interface(return_interface, PYTHON_SENDERS[1]))
            except BaseException:
                self.close()
                raise

    @property
    def is_ring(self) -> bool:
        """Whether it has a far end."""
        return len(self._sockets) > 1

    def close(self) -> None:
        """Let go of the sockets."""
        for each in self._sockets:
            each.close()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def exchange(self, *datagrams: Datagram) -> list[Datagram]:
        """What comes back of one frame, with the working counters; sent again when it is lost. Raises LinkError."""
        for _ in range(_TRIES):
            self._index = self._index % 255 + 1
            sent = [Datagram(d.command, d.address, d.data, 0, self._index) for d in datagrams]
            self._send(sent)
            if back := self._received(sent):
                return back
            self.lost += 1
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

    def _send(self, sent: Sequence[Datagram]) -> None:
        problems = []
        for each, sender in zip(self._sockets, PYTHON_SENDERS, strict=False):
            try:
                each.send(framed(sent, sender))
            except OSError as problem:
                problems.append(problem)
        if len(problems) == len(self._sockets):
            raise LinkError(f"{self.name} can't send: {problems[0].strerror}; is the interface up?") from problems[0]

    def _received(self, sent: Sequence[Datagram]) -> list[Datagram]:
        end, halves = time.monotonic() + _ANSWER_S, dict[bool, list[Datagram]]()
        while len(halves) < 2 and (left := end - time.monotonic()) > 0:
            for each in select.select(self._sockets, [], [], left)[0]:
                try:
                    frame = each.recv(2048)
                except OSError:
                    continue  # the interface went down: told once
                back = list(unframed(frame))
                if [(d.command, d.index, len(d.data)) for d in back] != [
                    (d.command, d.index, len(d.data)) for d in sent
                ]:
                    continue
                if not self.is_ring:
                    return back
                from_far = bool(frame[LAST_OF_SENDER] & FAR_BIT)
                if not from_far and each is self._sockets[1]:
                    self.open_behind = None
                    return back
                if frame[SENDER] & PROCESSED:
                    halves[from_far] = back
        return self._merged(halves.get(False, []), halves.get(True, []))

    def _merged(self, near: list[Datagram], far: list[Datagram]) -> list[Datagram]:
        """What both ends of a broken ring say, or the one of them that says anything."""
        for datagram in near or far:
            if datagram.command == registers.BRD:
                self.open_behind = near[0].wkc if near else 0
        if not (near and far):
            return near or far
        merged = []
        for one, other in zip(near, far, strict=True):
            data = one.data if one.wkc else other.data
            if one.command == registers.BRD:
                data = bytes(a | b for a, b in zip(one.data, other.data, strict=True))
            merged.append(Datagram(one.command, one.address, data, one.wkc + other.wkc, one.index))
        return merged


def open_interface(interface: str, sender: bytes) -> socket.socket:
    """A raw socket that hears frames which name `sender`, or that of the other end.

    Raises LinkError, which says what is missing.
    """
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
    """Let the kernel drop frames whose sender ends with another byte, `FAR_BIT` aside: a classic BPF program."""
    either = 0xFF & ~FAR_BIT
    program = [
        (_LOAD_BYTE, 0, 0, LAST_OF_SENDER),
        (_AND, 0, 0, either),
        (_IF_EQUAL, 0, 1, last & either),
        (_RETURN, 0, 0, 0xFFFF),
        (_RETURN, 0, 0, 0),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *each) for each in program))
    opened.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HL", len(program), ctypes.addressof(code)))
