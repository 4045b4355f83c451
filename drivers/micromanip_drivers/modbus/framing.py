"""Frames of Modbus TCP and RTU: a request sealed, an answer found in what came and compared with its request."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod

from fastcrc import crc16

# ruff: noqa: N818 (the names say what came)
from micromanip.driver import BusError, DeviceFault, TransientError

_MEANINGS = {
    1: "illegal function: it has none with this code",
    2: "illegal address: not all of these registers are there; compare address and address_base with its manual",
    3: "illegal value: it does not take the value, or so many registers at once",
    4: "device failure: look at the device itself",
    5: "acknowledged: it will take longer than a transaction",
    6: "busy",
    7: "negative acknowledge: it can't do that",
    8: "memory parity error: its memory is damaged",
    10: "gateway path unavailable: the gateway is overloaded, or not set up for this unit",
    11: "gateway target: the unit behind the gateway does not answer",
}
_PASSING = (5, 6, 11)
"""Those that another try may not meet."""


class BadFrame(Exception):
    """What came is no answer to what was asked, and more of it may be under way."""


class DamagedFrame(BadFrame):
    """By its form and length, or its number, it is the answer, and it is no good: nothing more is to be expected."""


def exception_error(title: str, code: int) -> BusError:
    """The error that stands for a Modbus exception, which answered the transaction called `title`."""
    text = f"{title}: exception {code}, {_MEANINGS.get(code, 'of the vendor: see its manual')}"
    return TransientError(text) if code in _PASSING else DeviceFault(text)


_HEADER = struct.Struct(">HHHB")
_LEAST, _MOST = 2, 254
"""Length field of a TCP frame: unit, and a PDU of 1 to 253 bytes."""
EXCEPTION_BYTES = 2
_NOISE = 4
"""So many bytes beside an answer are less than one of another would be."""


class Framing(ABC):
    """How a PDU travels. One request is out at a time."""

    overhead_bytes: int
    """What a frame has beside its PDU."""

    late = 0
    """Answers that came when nobody waited for them any more."""

    stray_bytes = 0
    """Bytes of noise beside good answers."""

    in_doubt = False
    """Whether an answer to an earlier request may still come by this connection."""

    came = ""
    """What came since the last request and was passed over, in words."""

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
    """Frames with a transaction number: an answer to another request is recognised, and dropped.

    A device that always answers with number 0 is believed, as long as no request of this connection went unanswered.
    """

    overhead_bytes = _HEADER.size

    def __init__(self) -> None:
        self._number = 0

    def seal(self, unit_id: int, pdu: bytes) -> bytes:
        self._number, self.came = self._number % 0xFFFF + 1, ""
        return _HEADER.pack(self._number, 0, len(pdu) + 1, unit_id) + pdu

    def take(self, buffer: bytearray, unit_id: int, head: bytes, length: int) -> bytes | None:
        while (frame := _tcp_frame(buffer)) is not None:
            number, unit, pdu = frame
            if number == 0 and self.in_doubt:
                raise BadFrame(f"it has transaction number 0 instead of {self._number}, and may answer what was before")
            if number not in (self._number, 0):  # requests begin at 1: 0 is that of a device which keeps none
                self.late += 1
                self.came = f"an answer came with transaction number {number} instead of {self._number}"
                continue
            if why := f"unit {unit} answered" if unit != unit_id else _strange(pdu, head, length):
                raise (DamagedFrame if number else BadFrame)(why)
            return pdu
        return None

    def idle(self, buffer: bytearray) -> None:
        while _tcp_frame(buffer) is not None:
            self.late += 1


class RtuFraming(Framing):
    """Frames with a checksum, and nothing that says to which request they belong.

    A few bytes of noise beside one, as a line without bias resistors makes them, do no harm to a good checksum.
    """

    overhead_bytes = 3

    def seal(self, unit_id: int, pdu: bytes) -> bytes:
        return sealed(bytes((unit_id,)) + pdu)

    def take(self, buffer: bytearray, unit_id: int, head: bytes, length: int) -> bytes | None:
        if not buffer:
            return None
        skipped = next((at for at in range(_NOISE + 1) if _may_begin(buffer[at:], unit_id, head)), None)
        if skipped is None and buffer[0] != unit_id:
            raise BadFrame(f"it begins with {buffer[0]}, not with the number of the unit")
        if skipped is None:
            raise BadFrame(f"it begins with {buffer[1 : 1 + len(head)].hex(' ')} instead of {head.hex(' ')}")
        began = buffer[skipped:]
        if began[1:2] and began[1] == head[0] | 0x80:
            length = EXCEPTION_BYTES
        end = length + self.overhead_bytes
        if len(began) < end:
            return None
        buffer.clear()
        frame, extra = bytes(began[:end]), len(began) - end
        if extra > _NOISE:
            raise BadFrame(f"{extra} bytes too many came")
        if sealed(frame[:-2]) != frame:
            if skipped:
                raise BadFrame(f"{skipped} bytes came before it, and its checksum is wrong")
            raise DamagedFrame("its checksum is wrong") if not extra else BadFrame(f"{extra} bytes too many came")
        self.stray_bytes += skipped + extra
        return frame[1:-2]

    def idle(self, buffer: bytearray) -> None:
        self.late += bool(buffer)
        buffer.clear()


def _may_begin(began: bytearray, unit_id: int, head: bytes) -> bool:
    """Whether the answer, or the exception to the request, may begin so; with nothing there it may still come."""
    if not began:
        return True
    code = bytes(began[1 : 1 + len(head)])
    return began[0] == unit_id and (code[:1] == bytes((head[0] | 0x80,)) or code == head[: len(code)])


def sealed(frame: bytes) -> bytes:
    """An RTU frame with its checksum."""
    return frame + crc16.modbus(frame).to_bytes(2, "little")


def _strange(pdu: bytes, head: bytes, length: int) -> str:
    """Why a PDU is neither the answer nor an exception to the request; empty where it is."""
    if len(pdu) == EXCEPTION_BYTES and pdu[0] == head[0] | 0x80:
        return ""
    if not pdu.startswith(head):
        return f"it begins with {pdu[: len(head)].hex(' ')} instead of {head.hex(' ')}"
    return "" if len(pdu) == length else f"it has {len(pdu)} bytes instead of {length}"


def _tcp_frame(buffer: bytearray) -> tuple[int, int, bytes] | None:
    """Transaction number, unit and PDU of the first frame, taken out; None while it is not complete."""
    if len(buffer) < _HEADER.size:
        return None
    number, protocol, length, unit = _HEADER.unpack_from(buffer)
    if protocol != 0 or not _LEAST <= length <= _MOST:
        raise BadFrame(f"it has no Modbus TCP header: it begins with {buffer[: _HEADER.size].hex(' ')}")
    end = _HEADER.size - 1 + length
    if len(buffer) < end:
        return None
    pdu = bytes(buffer[_HEADER.size : end])
    del buffer[:end]
    return number, unit, pdu
