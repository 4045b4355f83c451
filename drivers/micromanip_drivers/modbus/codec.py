"""Numbers in registers: bytes put in order, packed and unpacked, by plans that are made once.

A plan gets the registers of one transaction as they are on the wire. Its fields say where their number begins, counted
in registers (or coils) from the first one of the transaction.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from micromanip.driver import OutputRefused

from .task_options import REGISTERS, Input, Output, Register, code_range

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


class CoilPlan:
    """The same for bits that have an address of their own: eight in a byte, the first one lowest."""

    def __init__(self, fields: Sequence[Field]) -> None:
        self._places = [(field.place >> 3, field.place & 7) for field in fields]
        self._scales = [_scaling(field.register) for field in fields]

    def codes(self, data: bytes) -> list[float]:
        """0 or 1."""
        return [data[byte] >> bit & 1 for byte, bit in self._places]

    def values(self, data: bytes) -> list[float]:
        """The same with scale and offset."""
        return [scale * code + offset for code, (scale, offset) in zip(self.codes(data), self._scales, strict=True)]


class WritePlan:
    """The data of a request from the values of its fields; bits that no field covers are 0."""

    def __init__(self, fields: Sequence[Field], count: int) -> None:
        """`count` registers, or coils, from the first one."""
        self._coils = any(field.register.type == "coil" for field in fields)
        self.length = (count + 7) // 8 if self._coils else 2 * count
        """Bytes."""
        self._fields = [_Written(field) for field in fields]

    def data(self, values: Mapping[str, float]) -> bytes:
        """What goes over the wire. Raises OutputRefused for a value that its register does not hold."""
        data = bytearray(self.length)
        for field in self._fields:
            code = field.code(values[field.name])
            if self._coils:
                data[field.place >> 3] |= int(code) << (field.place & 7)
                continue
            for place, byte in zip(field.places, field.pack(code), strict=True):
                data[place] |= byte
        return bytes(data)


class _Written:
    """A field that is written: its number, within its range."""

    def __init__(self, field: Field) -> None:
        register = field.register
        assert isinstance(register, Output)
        self.name, self.place, self.places = field.name, field.place, field.bytes_of()
        self._register, self._shift = register, register.first_bit or 0
        self._struct = struct.Struct(">" + FORMATS.get(register.type, "H"))
        self._whole = not register.type.startswith("float")
        self._low, self._high = code_range(register)
        self._range = register.range or (-math.inf, math.inf)

    def pack(self, code: float) -> bytes:
        """Its registers, highest byte first, with nothing in the bits that are not its own."""
        return self._struct.pack(int(code) << self._shift if self._whole else code)

    def code(self, value: float) -> float:
        """The number that stands for a value, rounded to the nearest; OutputRefused where there is none."""
        register = self._register
        if not math.isfinite(value):
            raise OutputRefused(f"{self.name} is {value}: nothing was sent")
        if not self._range[0] <= value <= self._range[1]:
            low, high = self._range
            raise OutputRefused(f"{self.name} is {value:g}, outside of its range {low:g} to {high:g}: nothing was sent")
        code: float = (value - register.offset) / register.scale
        if math.isfinite(code):
            code = round(code) if self._whole else code
            if self._low <= code <= self._high:
                return code
        ends = sorted(register.scale * end + register.offset for end in (self._low, self._high))
        raise OutputRefused(
            f"{self.name} is {value:g}, its {register.type} holds {ends[0]:g} to {ends[1]:g}: nothing was sent"
        )


def _shift_and_mask(register: Register) -> tuple[int, int] | None:
    return None if register.first_bit is None else (register.first_bit, (1 << register.bit_count) - 1)


def _scaling(register: Register) -> tuple[float, float]:
    return (register.scale, register.offset) if isinstance(register, Input) else (1.0, 0.0)
