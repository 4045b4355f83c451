"""The checksum of a frame, as the configuration names it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import fastcrc

from micromanip.emulation.plain_options import Place, value
from micromanip.settings.text.source import Source

from .number import read_byte_order

_SIZES = {"crc8": 1, "crc16": 2, "crc32": 4, "crc64": 8}


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


def read_checksum(source: Source, place: Place, entry: Any) -> Checksum | None:
    """What a section says, None for a device without one; raises ConfigError with file, line and key."""
    if entry is None:
        return None
    name = value(source, place, entry, "name", str)
    width, _, algorithm = name.partition(".")
    function = getattr(getattr(fastcrc, width, None), algorithm, None) if width in _SIZES else None
    if function is None:
        raise source.error((*place, "name"), f"fastcrc has no {name}; crc16.modbus would be one")
    return Checksum(function, _SIZES[width], read_byte_order(source, place, entry), int(entry.get("first", 0)))
