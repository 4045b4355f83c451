"""Frames in plain Python: datagrams into an Ethernet frame, and back."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from .registers import ETHERTYPE, LRD, LRW, TYPE_DATAGRAMS

BROADCAST = b"\xff" * 6
MASTER = b"\x10\x10\x10\x10\x10\x10"
"""The sender that frames name: nobody answers to it."""
PROCESSED = 0x02
"""Bit that slaves set in the first byte of the sender: the frame has been through them."""
HEADER_BYTES, DATAGRAM_BYTES, WKC_BYTES, STATUS_BYTES = 16, 10, 2, 2
LEAST_BYTES = 60
_MORE = 0x8000


@dataclass(frozen=True)
class Datagram:
    """One datagram; `address` is a pair (slave, register), or a logical address of 32 bits."""

    command: int
    address: tuple[int, int] | int
    data: bytes
    wkc: int = 0
    index: int = 0

    @property
    def size(self) -> int:
        """Bytes in a frame."""
        return DATAGRAM_BYTES + len(self.data) + WKC_BYTES


def framed(datagrams: Sequence[Datagram], sender: bytes = MASTER) -> bytes:
    """An Ethernet frame of at least one datagram, padded to the least that a wire carries."""
    parts = []
    for datagram in datagrams:
        more = _MORE if datagram is not datagrams[-1] else 0
        address = datagram.address
        where = struct.pack("<I", address) if isinstance(address, int) else struct.pack("<HH", *address)
        head = struct.pack("<BB4sHH", datagram.command, datagram.index, where, len(datagram.data) | more, 0)
        parts.append(head + datagram.data + struct.pack("<H", datagram.wkc))
    body = b"".join(parts)
    ethernet = BROADCAST + sender + struct.pack(">H", ETHERTYPE)
    return (ethernet + struct.pack("<H", len(body) | TYPE_DATAGRAMS << 12) + body).ljust(LEAST_BYTES, b"\0")


def unframed(frame: bytes) -> Iterator[Datagram]:
    """The datagrams of a frame; none of one that is not EtherCAT, or up to the one that is cut off."""
    if len(frame) < HEADER_BYTES or frame[12:14] != struct.pack(">H", ETHERTYPE):
        return
    (head,) = struct.unpack_from("<H", frame, 14)
    end, at, more = HEADER_BYTES + (head & 0x7FF), HEADER_BYTES, head >> 12 == TYPE_DATAGRAMS
    while more and at + DATAGRAM_BYTES + WKC_BYTES <= min(end, len(frame)):
        command, index, where, length = struct.unpack_from("<BB4sH", frame, at)
        size, more = length & 0x7FF, bool(length & _MORE)
        data_at = at + DATAGRAM_BYTES
        at = data_at + size + WKC_BYTES
        if at > min(end, len(frame)):
            return
        address = struct.unpack("<I", where)[0] if LRD <= command <= LRW else struct.unpack("<HH", where)
        (wkc,) = struct.unpack_from("<H", frame, data_at + size)
        yield Datagram(command, address, frame[data_at : data_at + size], wkc, index)
