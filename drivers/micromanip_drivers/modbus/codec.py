"""Numbers in registers: bytes put in order, packed and unpacked, by plans that are made once.

A plan gets the registers of one transaction as they are on the wire. Its fields say where their number begins, counted
in registers (or coils) from the first one of the transaction.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from ..sent_number import sent_number
from .options import REGISTERS, Input, Output, Register, code_range

FORMATS = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q"} | {
    "float32": "f",
    "float64": "d",
    "bits": "H",
}


@dataclass(frozen=True)
class Field:
    """A register of the configuration at its place in a transaction."""

    name: str
    register: Register
    place: int
    """Registers, or coils, before it."""
    byte_order: str
    word_order: str

    def bytes_of(self) -> list[int]:
        """Where on the wire its bytes lie, the highest first."""
        count = REGISTERS[self.register.type]
        words = range(count) if self.word_order == "big" else range(count - 1, -1, -1)
        halves = (0, 1) if self.byte_order == "big" else (1, 0)
        return [2 * (self.place + word) + half for word in words for half in halves]


class ReadPlan:
    """Values of the fields from the data of an answer."""

    def __init__(self, fields: Sequence[Field]) -> None:
        order = [place for field in fields for place in field.bytes_of()]
        self._ordered = itemgetter(*order, 0)  # one place more: with a single one there would be no tuple
        self._struct = struct.Struct(">" + "".join(FORMATS[field.register.type] for field in fields) + "x")
        self._bits = [_shift_and_mask(field.register) for field in fields]
        self._scales = [_scaling(field.register) for field in fields]

    def codes(self, data: bytes) -> list[float]:
        """The numbers as the device has them."""
        numbers = self._struct.unpack(bytes(self._ordered(data)))
        return [
            number if bits is None else number >> bits[0] & bits[1]
            for number, bits in zip(numbers, self._bits, strict=True)
        ]

    def values(self, data: bytes) -> list[float]:
        """The same with scale and offset."""
        return [scale * code + offset for code, (scale, offset) in zip(self.codes(data), self._scales, strict=True)]


class CoilPlan(ReadPlan):
    """The same for bits that have an address of their own: eight in a byte, the first one lowest."""

    def __init__(self, fields: Sequence[Field]) -> None:
        self._places = [(field.place >> 3, field.place & 7) for field in fields]
        self._scales = [_scaling(field.register) for field in fields]

    def codes(self, data: bytes) -> list[float]:
        """0 or 1."""
        return [data[byte] >> bit & 1 for byte, bit in self._places]


class WritePlan:
    """The data of a request from the values of its fields; bits that no field covers are 0."""

    def __init__(self, fields: Sequence[Field], count: int) -> None:
        """`count` registers, or coils, from the first one."""
        self._coils = any(field.register.type == "coil" for field in fields)
        self.length = (count + 7) // 8 if self._coils else 2 * count
        """Bytes."""
        self._fields = [(field, _written(field.register), field.bytes_of()) for field in fields]

    def data(self, values: Mapping[str, float]) -> bytes:
        """What goes over the wire. Raises OutputRefused for a value that its register does not hold."""
        data = bytearray(self.length)
        for field, register, places in self._fields:
            whole, scaling = not register.type.startswith("float"), (register.scale, register.offset)
            number = sent_number(values[field.name], field.name, *scaling, code_range(register), register.range, whole)
            if self._coils:
                data[field.place >> 3] |= int(number) << (field.place & 7)
                continue
            sent = struct.pack(
                ">" + FORMATS[register.type], int(number) << (register.first_bit or 0) if whole else number
            )
            for place, byte in zip(places, sent, strict=True):
                data[place] |= byte
        return bytes(data)


def _written(register: Register) -> Output:
    assert isinstance(register, Output)
    return register


def _shift_and_mask(register: Register) -> tuple[int, int] | None:
    return None if register.first_bit is None else (register.first_bit, (1 << register.bit_count) - 1)


def _scaling(register: Register) -> tuple[float, float]:
    return (register.scale, register.offset) if isinstance(register, Input) else (1.0, 0.0)
