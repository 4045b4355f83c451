"""Frames of Modbus TCP and RTU: a request sealed, an answer found in what came and compared with its request."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod

from fastcrc import crc16

from .errors import BadFrame, DamagedFrame

_HEADER = struct.Struct(">HHHB")
_LEAST, _MOST = 2, 254
"""Length field of a TCP frame: unit, and a PDU of 1 to 253 bytes."""
EXCEPTION_BYTES = 2


class Framing(ABC):
    """How a PDU travels. One request is out at a time."""

    overhead_bytes: int
    """What a frame has beside its PDU."""

    late = 0
    """Answers that came when nobody waited for them any more."""

    @abstractmethod
    def seal(self, unit_id: int, pdu: bytes) -> bytes:
        """A request on its way."""

    @abstractmethod
    def take(self, buffer: bytearray, unit_id: int, head: bytes, length: int) -> bytes | None:
        """The PDU of the answer, taken out of `buffer`; None while it is not complete.

        It must come from `unit_id`, begin with `head` and have `length` bytes, or be the exception to that. Raises
        BadFrame for anything else.
        """

    @abstractmethod
    def idle(self, buffer: bytearray) -> None:
        """Drop what came with no request out. Raises BadFrame where the place of the next frame is lost."""


class TcpFraming(Framing):
    """Frames with a transaction number: an answer to another request is recognised, and dropped."""

    overhead_bytes = _HEADER.size

    def __init__(self) -> None:
        self._number = 0

    def seal(self, unit_id: int, pdu: bytes) -> bytes:
        self._number = self._number % 0xFFFF + 1
        return _HEADER.pack(self._number, 0, len(pdu) + 1, unit_id) + pdu

    def take(self, buffer: bytearray, unit_id: int, head: bytes, length: int) -> bytes | None:
        while (frame := _tcp_frame(buffer)) is not None:
            number, unit, pdu = frame
            if number != self._number:
                self.late += 1
                continue
            if unit != unit_id:
                raise BadFrame(f"unit {unit} answered")
            compare(pdu, head, length)
            return pdu
        return None

    def idle(self, buffer: bytearray) -> None:
        while _tcp_frame(buffer) is not None:
            self.late += 1


class RtuFraming(Framing):
    """Frames with a checksum, and nothing that says to which request they belong."""

    overhead_bytes = 3

    def seal(self, unit_id: int, pdu: bytes) -> bytes:
        return sealed(bytes((unit_id,)) + pdu)

    def take(self, buffer: bytearray, unit_id: int, head: bytes, length: int) -> bytes | None:
        if not buffer:
            return None
        if buffer[0] != unit_id:
            raise BadFrame(f"it begins with {buffer[0]}, not with the number of the unit")
        began = bytes(buffer[1 : 1 + len(head)])
        if began[:1] and began[0] == head[0] | 0x80:
            length = EXCEPTION_BYTES
        elif began != head[: len(began)]:
            raise BadFrame(f"it begins with {began.hex(' ')} instead of {head.hex(' ')}")
        if len(buffer) < length + self.overhead_bytes:
            return None
        frame = bytes(buffer)
        buffer.clear()
        if len(frame) > length + self.overhead_bytes:
            raise BadFrame(f"{len(frame) - length - self.overhead_bytes} bytes too many came")
        if sealed(frame[:-2]) != frame:
            raise DamagedFrame("its checksum is wrong")
        return frame[1:-2]

    def idle(self, buffer: bytearray) -> None:
        self.late += bool(buffer)
        buffer.clear()


def sealed(frame: bytes) -> bytes:
    """An RTU frame with its checksum."""
    return frame + crc16.modbus(frame).to_bytes(2, "little")


def compare(pdu: bytes, head: bytes, length: int) -> None:
    """Whether a PDU is the answer, or an exception to the request. Raises BadFrame."""
    if len(pdu) == EXCEPTION_BYTES and pdu[0] == head[0] | 0x80:
        return
    if not pdu.startswith(head):
        raise BadFrame(f"it begins with {pdu[: len(head)].hex(' ')} instead of {head.hex(' ')}")
    if len(pdu) != length:
        raise BadFrame(f"it has {len(pdu)} bytes instead of {length}")


def _tcp_frame(buffer: bytearray) -> tuple[int, int, bytes] | None:
    """Transaction number, unit and PDU of the first frame, taken out; None while it is not complete."""
    if len(buffer) < _HEADER.size:
        return None
    number, protocol, length, unit = _HEADER.unpack_from(buffer)
    if protocol != 0 or not _LEAST <= length <= _MOST:
        raise BadFrame("it has no Modbus TCP header")
    end = _HEADER.size - 1 + length
    if len(buffer) < end:
        return None
    pdu = bytes(buffer[_HEADER.size : end])
    del buffer[:end]
    return number, unit, pdu
