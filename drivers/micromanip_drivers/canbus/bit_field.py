"""Where a signal lies in its frame, and how its code becomes a number: what a DBC says, as shift and mask."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

GREATEST = {16: 65504.0, 32: (2 - 2**-23) * 2.0**127, 64: (2 - 2**-52) * 2.0**1023}
"""The greatest IEEE 754 numbers, by their bits."""
_FLOATS = {16: struct.Struct("<e"), 32: struct.Struct("<f"), 64: struct.Struct("<d")}


@dataclass(frozen=True)
class BitField:
    """A signal of a frame that is read as one integer, in the signal's own byte order."""

    name: str
    big_endian: bool
    """Motorola byte order: the frame's first byte is the highest; else it is the lowest."""
    shift: int
    bits: int
    sign: int
    """The sign bit of a signed code, else 0: ``(code ^ sign) - sign`` extends it."""
    floating: struct.Struct | None
    """Layout of an IEEE 754 number; None for an integer code."""
    scale: float
    offset: float
    low: float
    high: float
    """What may be sent: codes that the bits hold and the range of the DBC allows; of an IEEE 754 number, values."""

    @property
    def mask(self) -> int:
        """As many ones as it has bits."""
        return (1 << self.bits) - 1


def bit_field(signal: Any, message_length: int) -> BitField:
    """Of a signal of cantools, in a message of so many bytes."""
    big_endian = signal.byte_order == "big_endian"
    if big_endian:
        from_start = 8 * (signal.start // 8) + 7 - signal.start % 8  # its highest bit, counted from the frame's first
        shift = 8 * message_length - from_start - signal.length
    else:
        shift = signal.start
    low, high = _ends(signal)
    return BitField(
        name=signal.name,
        big_endian=big_endian,
        shift=shift,
        bits=signal.length,
        sign=1 << (signal.length - 1) if signal.is_signed and not signal.is_float else 0,
        floating=_FLOATS[signal.length] if signal.is_float else None,
        scale=float(signal.scale),
        offset=float(signal.offset),
        low=low,
        high=high,
    )


def _ends(signal: Any) -> tuple[float, float]:
    if signal.is_float:
        low, high = -GREATEST[signal.length], GREATEST[signal.length]
    elif signal.is_signed:
        low, high = -(2 ** (signal.length - 1)), 2 ** (signal.length - 1) - 1
    else:
        low, high = 0, 2**signal.length - 1
    for limit, is_minimum in ((signal.minimum, True), (signal.maximum, False)):
        if limit is None:
            continue
        end = (limit - signal.offset) / signal.scale
        if not signal.is_float:
            end = round(end)
        if is_minimum == (signal.scale > 0):
            low = max(low, end)
        else:
            high = min(high, end)
    return low, high
