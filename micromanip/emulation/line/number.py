"""A number in a frame: where it lies, its type, byte order, scale and offset; and the checksum behind all of them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

_FLOATS = {"float32": "f", "float64": "d"}
_SIZES = {
    **{f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 24, 32, 64)},
    "float32": 4,
    "float64": 8,
}


@dataclass(frozen=True)
class LineNumber:
    """value = scale x number + offset."""

    at: int
    kind: str
    byte_order: Literal["little", "big"] = "little"
    scale: float = 1.0
    offset: float = 0.0

    @cached_property
    def size(self) -> int:
        """How many bytes it has."""
        return _SIZES[self.kind]

    @cached_property
    def end(self) -> int:
        """The byte behind its last."""
        return self.at + self.size

    @cached_property
    def counts(self) -> int:
        """How many numbers it can be, for one that counts."""
        return int(256**self.size)

    def put(self, frame: bytearray, value: float) -> None:
        """Write a value: the nearest that it can hold; NaN as such where the type has it, else as the largest code."""
        number = (value - self.offset) / self.scale
        if self.kind in _FLOATS:
            frame[self.at : self.end] = struct.pack(self._format, number)
            return
        low, high = self._ends
        code = high if math.isnan(number) else min(max(round(min(max(number, low), high)), low), high)
        self.put_code(frame, code)

    def put_code(self, frame: bytearray, code: int) -> None:
        """Write a whole number, without scale."""
        frame[self.at : self.end] = code.to_bytes(self.size, self.byte_order, signed=self._signed)

    def get(self, frame: bytes) -> float:
        """Its value."""
        return self.scale * self._number(frame) + self.offset

    def code(self, frame: bytes) -> int:
        """It as a whole number, without scale."""
        return int(self._number(frame))

    def _number(self, frame: bytes) -> float:
        part = frame[self.at : self.end]
        if self.kind in _FLOATS:
            number: float = struct.unpack(self._format, part)[0]
            return number
        return int.from_bytes(part, self.byte_order, signed=self._signed)

    @cached_property
    def _signed(self) -> bool:
        return self.kind.startswith("i")

    @cached_property
    def _ends(self) -> tuple[int, int]:
        bits = 8 * self.size
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if self._signed else (0, (1 << bits) - 1)

    @cached_property
    def _format(self) -> str:
        return ("<" if self.byte_order == "little" else ">") + _FLOATS[self.kind]


@dataclass(frozen=True)
class Checksum:
    """It is the last of a frame, and covers all from byte `first` on."""

    function: Callable[[bytes], int]
    size: int
    byte_order: Literal["little", "big"] = "little"
    first: int = 0

    def of(self, covered: bytes) -> bytes:
        """The checksum of a frame that still has none."""
        return self.function(covered[self.first :]).to_bytes(self.size, self.byte_order)

    def fits(self, frame: bytes) -> bool:
        """Whether a whole frame is good."""
        return len(frame) > self.size and self.of(frame[: -self.size]) == frame[-self.size :]


def line_number(keys: Any) -> LineNumber:
    """The number that these keys of the driver describe."""
    return LineNumber(
        keys.at, keys.type, keys.byte_order or "little", getattr(keys, "scale", 1.0), getattr(keys, "offset", 0.0)
    )


def optional_number(keys: Any) -> LineNumber | None:
    """The same where the device may have none."""
    return None if keys is None else line_number(keys)


def line_numbers(keys: Mapping[str, Any]) -> dict[str, LineNumber]:
    """Several, by name."""
    return {name: line_number(number) for name, number in keys.items()}


def checksum(keys: Any) -> Checksum | None:
    """The checksum that these keys of the driver describe, None for a device without one."""
    return None if keys is None else Checksum(keys.function, keys.size, keys.byte_order, keys.first)
