"""What a Modbus unit answers to a request: functions 1 to 6, 15, 16 and 23, and exceptions; its frames, TCP and RTU.

Written after the protocol's specification, not on the library that the driver uses: an error of one of them shows.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Protocol

from fastcrc import crc16

from .unit import COILS, HOLDING, INPUT_REGISTERS, INPUTS, ModbusUnit

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
_READS = {1: (COILS, 2000), 2: (INPUTS, 2000), 3: (HOLDING, 125), 4: (INPUT_REGISTERS, 125)}
"""Table, and the most that one request may ask for."""
_SINGLE, _MULTIPLE = {5: COILS, 6: HOLDING}, {15: (COILS, 1968), 16: (HOLDING, 123)}
_ON, _OFF = 0xFF00, 0x0000
_FIXED_BYTES = dict.fromkeys((1, 2, 3, 4, 5, 6), 5)
_COUNT_AT = {15: 5, 16: 5, 23: 9}


class Refused(Exception):  # noqa: N818 (the protocol calls it an exception)
    """The unit answers with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def request_bytes(begin: bytes) -> int | None:
    """Length of a request, from the function code on; None while `begin` doesn't tell, 0 for an unknown function."""
    if not begin:
        return None
    if begin[0] in _FIXED_BYTES:
        return _FIXED_BYTES[begin[0]]
    at = _COUNT_AT.get(begin[0])
    if at is None:
        return 0
    return at + 1 + begin[at] if len(begin) > at else None


def answer(unit: ModbusUnit, request: bytes, now_ns: int) -> bytes:
    """The answer of a unit, from the function code on."""
    try:
        return _answer(unit, request, now_ns)
    except Refused as refusal:
        return refused(request, refusal.code)
    except (struct.error, IndexError):
        return refused(request, ILLEGAL_VALUE)


def refused(request: bytes, code: int) -> bytes:
    """The exception in place of an answer."""
    return bytes((request[0] | 0x80, code))


def _answer(unit: ModbusUnit, request: bytes, now_ns: int) -> bytes:
    function = request[0]
    if function in _READS:
        first, count = struct.unpack(">HH", request[1:])
        return bytes((function,)) + _read(unit, *_READS[function], first, count, now_ns)
    if function in _SINGLE:
        address, word = struct.unpack(">HH", request[1:])
        if function == 5 and word not in (_ON, _OFF):
            raise Refused(ILLEGAL_VALUE)
        _write(unit, _SINGLE[function], address, [int(word == _ON) if function == 5 else word])
        return request
    if function in _MULTIPLE:
        table, most = _MULTIPLE[function]
        first, count, length = struct.unpack(">HHB", request[1:6])
        words = _words(table, request[6:], count, length, most)
        _write(unit, table, first, words)
        return request[:5]
    if function == 23:
        first, count, to, written, length = struct.unpack(">HHHHB", request[1:10])
        words = _words(HOLDING, request[10:], written, length, 121)
        if not 1 <= count <= 125:
            raise Refused(ILLEGAL_VALUE)
        _write(unit, HOLDING, to, words)  # before it reads, says the specification
        return bytes((function,)) + _read(unit, HOLDING, 125, first, count, now_ns)
    raise Refused(ILLEGAL_FUNCTION)


def _read(unit: ModbusUnit, table: str, most: int, first: int, count: int, now_ns: int) -> bytes:
    """Length and data."""
    if not 1 <= count <= most:
        raise Refused(ILLEGAL_VALUE)
    words = unit.read(table, first, count, now_ns)
    if words is None:
        raise Refused(ILLEGAL_ADDRESS)
    if table in (COILS, INPUTS):
        packed = sum(bit << i for i, bit in enumerate(words)).to_bytes((count + 7) // 8, "little")
    else:
        packed = struct.pack(f">{count}H", *words)
    return bytes((len(packed),)) + packed


def _write(unit: ModbusUnit, table: str, first: int, words: list[int]) -> None:
    if not unit.write(table, first, words):
        raise Refused(ILLEGAL_ADDRESS)


def _words(table: str, data: bytes, count: int, length: int, most: int) -> list[int]:
    if not 1 <= count <= most or len(data) != length or length != ((count + 7) // 8 if table == COILS else 2 * count):
        raise Refused(ILLEGAL_VALUE)
    if table == COILS:
        return [data[i >> 3] >> (i & 7) & 1 for i in range(count)]
    return list(struct.unpack(f">{count}H", data))


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
