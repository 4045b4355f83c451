"""A number in the registers of a simulated Modbus device: its type, orders, scale and offset, as configured."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from micromanip.bus.number_options import SIZES
from micromanip.emulation.line.number import LineNumber


@dataclass(frozen=True)
class _Keys:
    """A number in a frame of its own, the highest byte first."""

    type: str
    size: int
    end: int
    scale: float
    offset: float
    at: int = 0
    byte_order: str = "big"


class DeviceRegister(LineNumber):
    """value = scale x number + offset."""

    def __init__(self, name: str, unit: Any, entry: Any) -> None:
        """`unit` and `entry` are the driver's keys."""
        self.name, self.is_bits = name, entry.type == "bits"
        self.address: int = entry.address - unit.address_base
        """As it goes over the wire."""
        few = self.is_bits or entry.type == "coil"
        kind = "uint16" if few else entry.type
        self.width = SIZES[kind] // 2
        """How many registers, or coils, it takes."""
        self._shift, self._big_words = getattr(entry, "first_bit", None) or 0, unit.word_order == "big"
        self._big_bytes = unit.byte_order == "big" or entry.type == "coil"
        scale, offset = getattr(entry, "scale", 1.0), getattr(entry, "offset", 0.0)
        super().__init__(_Keys(kind, SIZES[kind], SIZES[kind], scale, offset))
        if few:
            self.low, self.high = 0, (1 << getattr(entry, "bit_count", 1)) - 1
        self.mask = self.code_words(self.high)[0] if self.is_bits else 0xFFFF
        """Bits of its registers that it takes, as they go over the wire."""

    def words(self, value: float) -> Sequence[int]:
        """The registers that hold a value, the nearest that they can; NaN as such, or as the largest number."""
        frame = bytearray(2 * self.width)
        self.put(frame, value)
        return self._ordered(frame)

    def code_words(self, code: float) -> Sequence[int]:
        """The registers that hold a number, without scale."""
        frame = bytearray(2 * self.width)
        self.write(frame, code)
        return self._ordered(frame)

    def value(self, words: Sequence[int]) -> float:
        """What its registers say."""
        return self.get(struct.pack(f">{self.width}H", *self._ordered(struct.pack(f">{self.width}H", *words))))

    def read(self, data: bytes | bytearray, at: int = 0) -> float:
        number = super().read(data, at)
        return int(number) >> self._shift & int(self.high) if self.is_bits else number

    def write(self, data: bytearray, number: float) -> None:
        super().write(data, int(number) << self._shift if self.is_bits else number)

    def _ordered(self, frame: bytes | bytearray) -> Sequence[int]:
        """The highest first, to registers in the device's order; and back."""
        words = struct.unpack(f">{self.width}H", frame)
        words = words if self._big_words else words[::-1]
        return words if self._big_bytes else [(word & 0xFF) << 8 | word >> 8 for word in words]
