"""CAN frames as SocketCAN lays them out (``struct can_frame``, ``struct canfd_frame``), and its drivers' error frames.

``linux/can/error.h``: how a client hears what its controller met.
"""

from __future__ import annotations

import struct
from enum import IntFlag
from typing import NamedTuple

EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
"""CAN_EFF_FLAG, CAN_RTR_FLAG and CAN_ERR_FLAG of the identifier's word."""
STANDARD_MASK, EXTENDED_MASK = 0x7FF, 0x1FFF_FFFF
BITRATE_SWITCH_FLAG, FD_FLAG = 0x01, 0x04
"""CANFD_BRS and CANFD_FDF of the flags' byte."""

STAMP = struct.Struct("=q")
"""A packet between hub and client is a time stamp, ns of CLOCK_MONOTONIC, and a frame."""
CLASSIC = struct.Struct("=IBxxx8s")
FD = struct.Struct("=IBBxx64s")


class Frame(NamedTuple):
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


class ErrorClass(IntFlag):
    """What an error frame is about: its identifier."""

    CONTROLLER = 0x004
    PROTOCOL = 0x008
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    RESTARTED = 0x100
    COUNTERS = 0x200


class Controller(IntFlag):
    """Status of the controller: data byte 1."""

    RX_OVERFLOW = 0x01
    RX_WARNING = 0x04
    TX_WARNING = 0x08
    RX_PASSIVE = 0x10
    TX_PASSIVE = 0x20
    ACTIVE = 0x40


_ON_TRANSMISSION = 0x80  # CAN_ERR_PROT_TX, data byte 2
_IN_CRC_SEQUENCE = 0x08  # CAN_ERR_PROT_LOC_CRC_SEQ, data byte 3


def controller_error(status: Controller, transmit_errors: int = 0, receive_errors: int = 0) -> Frame:
    """The controller's status changed; its error counters are told up to 255."""
    counters = bytes((min(transmit_errors, 255), min(receive_errors, 255)))
    return _error(ErrorClass.CONTROLLER | ErrorClass.COUNTERS, bytes((0, status, 0, 0, 0, 0)) + counters)


def bus_error(own: bool) -> Frame:
    """A frame was destroyed on the bus; `own` to the one who sent it."""
    data = bytes((0, 0, _ON_TRANSMISSION if own else 0, _IN_CRC_SEQUENCE, 0, 0, 0, 0))
    return _error(ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR, data)


def bus_off() -> Frame:
    """The controller took itself off the bus."""
    return _error(ErrorClass.BUS_OFF, bytes(8))


def restarted() -> Frame:
    """The controller takes part again, error-active."""
    return _error(ErrorClass.RESTARTED, bytes(8))


def _error(classes: ErrorClass, data: bytes) -> Frame:
    return Frame(int(classes), data, error=True)
