"""Requests found in what a simulated Modbus device hears, and answers put into frames: TCP and RTU."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Protocol

from fastcrc import crc16

from .server import request_bytes

_HEADER = struct.Struct(">HHHB")
_MOST_PDU_BYTES = 253


class Request:
    """A request, and how its answer is put into a frame."""

    def __init__(self, unit: int, pdu: bytes, seal: Callable[[bytes], bytes]) -> None:
        self.unit, self.pdu, self.seal = unit, pdu, seal


class Frames(Protocol):
    """What came from one peer."""

    overhead_bytes: int
    """What a frame has beside its PDU."""

    def taken(self, data: bytes, now_ns: int) -> Iterator[Request]:
        """The requests that are complete with `data`."""


class TcpFrames(Frames):
    """Modbus TCP: a header with transaction number and length."""

    overhead_bytes = _HEADER.size

    def __init__(self) -> None:
        self._buffer = bytearray()

    def taken(self, data: bytes, now_ns: int) -> Iterator[Request]:  # noqa: ARG002
        self._buffer += data
        while len(self._buffer) >= _HEADER.size:
            number, protocol, length, unit = _HEADER.unpack_from(self._buffer)
            if protocol or not 2 <= length <= _MOST_PDU_BYTES + 1:
                self._buffer.clear()  # nothing says where the next one begins
                return
            end = _HEADER.size - 1 + length
            if len(self._buffer) < end:
                return
            pdu = bytes(self._buffer[_HEADER.size : end])
            del self._buffer[:end]
            yield Request(unit, pdu, _tcp_seal(number, unit))


class RtuFrames(Frames):
    """Modbus RTU: frames end with a checksum, and with silence."""

    overhead_bytes = 3

    def __init__(self, silence_ns: int) -> None:
        """What was begun is thrown away after a silence of so long."""
        self._silence_ns, self._buffer, self._heard_ns = silence_ns, bytearray(), 0

    def taken(self, data: bytes, now_ns: int) -> Iterator[Request]:
        if now_ns - self._heard_ns > self._silence_ns:
            self._buffer.clear()
        self._heard_ns = now_ns
        self._buffer += data
        length = request_bytes(bytes(self._buffer[1:]))
        if length is None or len(self._buffer) < length + self.overhead_bytes:
            return
        frame = bytes(self._buffer)
        self._buffer.clear()
        whole = not length or len(frame) == length + self.overhead_bytes  # an unknown function ends where it ends
        if whole and sealed(frame[:-2]) == frame:
            yield Request(frame[0], frame[1:-2], _rtu_seal(frame[0]))


def _tcp_seal(number: int, unit: int) -> Callable[[bytes], bytes]:
    return lambda pdu: _HEADER.pack(number, 0, len(pdu) + 1, unit) + pdu


def _rtu_seal(unit: int) -> Callable[[bytes], bytes]:
    return lambda pdu: sealed(bytes((unit,)) + pdu)


def sealed(frame: bytes) -> bytes:
    """An RTU frame with its checksum."""
    return frame + crc16.modbus(frame).to_bytes(2, "little")
