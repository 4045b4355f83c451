"""A number in a frame, as the configuration lays it out: where it lies, its type, byte order, scale and offset."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from micromanip.emulation.plain_options import Place, value
from micromanip.settings.text.source import Source

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


def read_number(source: Source, place: Place, entry: Any) -> LineNumber:
    """The number that a section describes; raises ConfigError with file, line and key."""
    kind = value(source, place, entry, "type", str)
    if kind not in _SIZES:
        raise source.error((*place, "type"), f"there is no type {kind}; there are {', '.join(_SIZES)}")
    at = value(source, place, entry, "at", int)
    return LineNumber(
        at, kind, read_byte_order(source, place, entry), float(entry.get("scale", 1.0)), float(entry.get("offset", 0.0))
    )


def read_byte_order(source: Source, place: Place, entry: Mapping[str, Any]) -> Literal["little", "big"]:
    """Of a number or a checksum; raises ConfigError with file, line and key for one that doesn't exist."""
    match entry.get("byte_order") or "little":
        case "little":
            return "little"
        case "big":
            return "big"
        case other:
            raise source.error((*place, "byte_order"), f"must be little or big, not {other}")


def read_optional(source: Source, place: Place, entry: Any, key: str) -> LineNumber | None:
    """The same for a key that may be left out."""
    return read_number(source, (*place, key), entry[key]) if entry.get(key) is not None else None
