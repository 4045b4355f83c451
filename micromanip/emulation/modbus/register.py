"""A number in the registers of a simulated Modbus device: its type, orders, scale and offset, as configured."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

FLOATS = {"float32": "f", "float64": "d"}
WIDTHS = {
    **dict.fromkeys(("bits", "int16", "uint16", "coil"), 1),
    **dict.fromkeys(("int32", "uint32", "float32"), 2),
    **dict.fromkeys(("int64", "uint64", "float64"), 4),
}
"""Registers, or coils, that a type takes."""


@dataclass(frozen=True)
class DeviceRegister:
    """value = scale x number + offset."""

    name: str
    address: int
    """As it goes over the wire."""
    kind: str
    big_bytes: bool = True
    big_words: bool = True
    scale: float = 1.0
    offset: float = 0.0
    first_bit: int = 0
    bit_count: int = 16

    @property
    def width(self) -> int:
        """How many registers it takes."""
        return WIDTHS[self.kind]

    @property
    def mask(self) -> int:
        """Bits of its registers that it takes: all of them, but for some bits of one."""
        return ((1 << self.bit_count) - 1) << self.first_bit if self.kind == "bits" else 0xFFFF

    def words(self, value: float) -> list[int]:
        """The registers that hold a value, the nearest that they can; NaN as such, or as the largest number."""
        return self.code_words(self._code((value - self.offset) / self.scale))

    def code_words(self, code: float) -> list[int]:
        """The registers that hold a number, without scale."""
        if self.kind in ("bits", "coil"):
            return self._swapped([int(code) << self.first_bit])
        if self.kind in FLOATS:
            packed = struct.pack(">" + FLOATS[self.kind], code)
        else:
            packed = int(code).to_bytes(2 * self.width, "big", signed=self.kind.startswith("i"))
        words = list(struct.unpack(f">{self.width}H", packed))
        return self._swapped(words if self.big_words else words[::-1])

    def value(self, words: list[int]) -> float:
        """What its registers say."""
        plain = self._swapped(words)
        if self.kind in ("bits", "coil"):
            number: float = (plain[0] & self.mask) >> self.first_bit
        else:
            packed = struct.pack(f">{self.width}H", *(plain if self.big_words else plain[::-1]))
            if self.kind in FLOATS:
                number = struct.unpack(">" + FLOATS[self.kind], packed)[0]
            else:
                number = int.from_bytes(packed, "big", signed=self.kind.startswith("i"))
        return self.scale * number + self.offset

    def _code(self, number: float) -> float:
        if self.kind in FLOATS:
            return number
        low, high = self._ends
        return high if math.isnan(number) else min(max(round(min(max(number, low), high)), low), high)

    @property
    def _ends(self) -> tuple[int, int]:
        bits = {"bits": self.bit_count, "coil": 1}.get(self.kind, 16 * self.width)
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if self.kind.startswith("i") else (0, (1 << bits) - 1)

    def _swapped(self, words: list[int]) -> list[int]:
        if self.big_bytes or self.kind == "coil":
            return words
        return [(word & 0xFF) << 8 | word >> 8 for word in words]
