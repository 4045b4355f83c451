"""CAN frames as SocketCAN lays them out: ``struct can_frame`` and ``struct canfd_frame``."""

from __future__ import annotations

import struct
from dataclasses import dataclass

EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
"""CAN_EFF_FLAG, CAN_RTR_FLAG and CAN_ERR_FLAG of the identifier's word."""
STANDARD_MASK, EXTENDED_MASK = 0x7FF, 0x1FFF_FFFF
BITRATE_SWITCH_FLAG, FD_FLAG = 0x01, 0x04
"""CANFD_BRS and CANFD_FDF of the flags' byte."""

STAMP = struct.Struct("=q")
"""A packet between hub and client is a time stamp, ns of CLOCK_MONOTONIC, and a frame."""
CLASSIC = struct.Struct("=IBxxx8s")
FD = struct.Struct("=IBBxx64s")


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame; for an error frame, `identifier` holds the error classes of ``linux/can/error.h``."""

    identifier: int
    data: bytes = b""
    extended: bool = False
    fd: bool = False
    bitrate_switch: bool = False
    remote: bool = False
    error: bool = False

    @property
    def priority(self) -> int:
        """What the arbitration compares, bit by bit as they go over the wire: the lowest wins."""
        if self.extended:
            base, extension = self.identifier >> 18, self.identifier & 0x3FFFF
            return (base << 21) | (0b11 << 19) | (extension << 1) | self.remote  # recessive SRR and IDE
        return (self.identifier << 21) | (self.remote << 20)


def pack(frame: Frame) -> bytes:
    """The frame's ``struct``: 16 bytes, or 72 for CAN FD. Raises ValueError for an identifier out of range."""
    word = frame.identifier
    if not 0 <= word <= (EXTENDED_MASK if frame.extended or frame.error else STANDARD_MASK):
        raise ValueError(f"identifier {word:#x} is not one of {29 if frame.extended else 11} bits")
    if frame.extended:
        word |= EXTENDED_FLAG
    if frame.remote:
        word |= REMOTE_FLAG
    if frame.error:
        word |= ERROR_FLAG
    if frame.fd:
        flags = FD_FLAG | BITRATE_SWITCH_FLAG if frame.bitrate_switch else FD_FLAG
        return FD.pack(word, len(frame.data), flags, frame.data)
    return CLASSIC.pack(word, len(frame.data), frame.data)


def unpack(packed: bytes) -> Frame:
    """The frame in ``packed``. Raises ValueError for what is none."""
    fd = len(packed) == FD.size
    if not fd and len(packed) != CLASSIC.size:
        raise ValueError(f"a CAN frame has {CLASSIC.size} or {FD.size} bytes, not {len(packed)}")
    flags = 0
    if fd:
        word, length, flags, data = FD.unpack(packed)
    else:
        word, length, data = CLASSIC.unpack(packed)
    if length > len(data):
        raise ValueError(f"a CAN frame of {len(packed)} bytes holds {len(data)} bytes of data at most, not {length}")
    extended, error = bool(word & EXTENDED_FLAG), bool(word & ERROR_FLAG)
    mask = EXTENDED_MASK if extended or error else STANDARD_MASK
    return Frame(
        word & mask,
        data[:length],
        extended,
        fd,
        bool(flags & BITRATE_SWITCH_FLAG),
        bool(word & REMOTE_FLAG),
        error,
    )
