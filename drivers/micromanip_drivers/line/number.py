"""Numbers in frames: bytes to a number and back, by type and byte order."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from micromanip.driver import OutputRefused, number_range

from .frame_options import InputField, Number, OutputField

_CODES = {1: "b", 2: "h", 4: "i", 8: "q"}
_FLOATS = {"float32": "f", "float64": "d"}


class NumberCodec:
    """A number at its place; `at` is where its frame begins in the bytes that it is given."""

    def __init__(self, options: Number) -> None:
        self._at, self._size = options.at, options.size
        self._order = options.byte_order or "little"
        self._signed = options.type.startswith("int")
        self.floating = options.type.startswith("float")
        self._layout: struct.Struct | None = None
        order = "<" if self._order == "little" else ">"
        self.low, self.high = number_range(options.type)
        if self.floating:
            self._layout = struct.Struct(order + _FLOATS[options.type])
        elif self._size in _CODES:
            code = _CODES[self._size]
            self._layout = struct.Struct(order + (code if self._signed else code.upper()))

    def read(self, data: bytes | bytearray, at: int = 0) -> float:
        """The number; an int for a type that is one."""
        place = at + self._at
        if self._layout is not None:
            number: float = self._layout.unpack_from(data, place)[0]
            return number
        return int.from_bytes(data[place : place + self._size], self._order, signed=self._signed)

    def write(self, data: bytearray, number: float) -> None:
        """Put a number that the type holds into `data`."""
        if self._layout is not None:
            self._layout.pack_into(data, self._at, number if self.floating else int(number))
            return
        data[self._at : self._at + self._size] = int(number).to_bytes(self._size, self._order, signed=self._signed)

    @property
    def counts(self) -> int:
        """How many values an unsigned integer has before it wraps."""
        return 1 << (8 * self._size)


class InputNumber:
    """A number of a frame as a value: scale x number + offset."""

    def __init__(self, options: InputField) -> None:
        self._codec = NumberCodec(options)
        self._scale, self._offset = options.scale, options.offset

    def value(self, data: bytes | bytearray, at: int = 0) -> float:
        """The value; not finite where a floating-point number is not."""
        return self._codec.read(data, at) * self._scale + self._offset


class OutputNumber:
    """A value as a number of a frame, with the range that it may have."""

    def __init__(self, name: str, options: OutputField) -> None:
        self._name = name
        self._codec = NumberCodec(options)
        self._scale, self._offset = options.scale, options.offset
        ends = sorted(end * options.scale + options.offset for end in (self._codec.low, self._codec.high))
        self._low, self._high = ends if options.range is None else options.range

    def put(self, data: bytearray, value: float) -> None:
        """Write `value`, rounded to the nearest number. Raises OutputRefused."""
        if not math.isfinite(value):
            raise OutputRefused(f"{self._name} is {value}: nothing was sent")
        number = (value - self._offset) / self._scale
        if not self._codec.floating and math.isfinite(number):  # a small scale may make it infinite
            number = round(number)
        if not (self._low <= value <= self._high and self._codec.low <= number <= self._codec.high):
            raise OutputRefused(
                f"{self._name} is {value:g}, it may be {self._low:g} to {self._high:g}: nothing was sent"
            )
        self._codec.write(data, number)


def mismatches(numbers: Mapping[str, tuple[NumberCodec, int]], data: bytes) -> Sequence[str]:
    """Which of the `numbers`, given with what they must be, are other ones in `data`: in words."""
    found = ((name, codec.read(data), wanted) for name, (codec, wanted) in numbers.items())
    return [f"{name} {number}, the configuration says {wanted}" for name, number, wanted in found if number != wanted]
