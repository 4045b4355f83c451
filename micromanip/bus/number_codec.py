"""Numbers in frames: bytes to a number and back, by type and byte order."""

from __future__ import annotations

import struct
from typing import Any, Protocol

from .number_options import number_range

_CODES = {1: "b", 2: "h", 4: "i", 8: "q"}
_FLOATS = {"float32": "f", "float64": "d"}


class NumberKeys(Protocol):
    """A number in a frame."""

    @property
    def at(self) -> int:
        """Its first byte."""

    @property
    def size(self) -> int:
        """How many bytes it has."""

    @property
    def type(self) -> str:
        """uint8 to uint64, int8 to int64, float32, float64; bool to bit15 of one that has `bit` and `bits`, too."""

    @property
    def byte_order(self) -> str | None:
        """Little or big; None for a single byte."""


class NumberCodec:
    """A number at its place; `at` is where its frame begins in the bytes that it is given."""

    def __init__(self, options: NumberKeys) -> None:
        self._at, self._size = options.at, options.size
        self._order: Any = options.byte_order or "little"
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
