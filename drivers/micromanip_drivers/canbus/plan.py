"""Frames taken apart and put together: plans that are made once, from the DBC, and cost a shift and a mask a signal.

cantools gives the layouts, and is what the tests compare with; it takes several times as long for each frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from micromanip.io.bus_errors import OutputRefused

from .bit_field import BitField


class UnpackPlan:
    """Values of some signals of a message, in the order of `fields`."""

    def __init__(self, fields: Sequence[BitField]) -> None:
        self._any_big = any(field.big_endian for field in fields)
        self._any_little = not all(field.big_endian for field in fields)
        self._rows = [
            (field.big_endian, field.shift, field.mask, field.sign, field.floating, field.scale, field.offset)
            for field in fields
        ]

    def codes(self, data: bytes | bytearray) -> list[int]:
        """What the bits say, before scale and offset; `data` has the length of the message."""
        big = int.from_bytes(data, "big") if self._any_big else 0
        little = int.from_bytes(data, "little") if self._any_little else 0
        return [
            (((big if big_endian else little) >> shift & mask) ^ sign) - sign
            for big_endian, shift, mask, sign, _, _, _ in self._rows
        ]

    def values(self, data: bytes | bytearray) -> list[float]:
        """The values; `data` has the length of the message."""
        big = int.from_bytes(data, "big") if self._any_big else 0
        little = int.from_bytes(data, "little") if self._any_little else 0
        values = []
        for big_endian, shift, mask, sign, floating, scale, offset in self._rows:
            code = (big if big_endian else little) >> shift & mask
            if floating is None:
                values.append(float(((code ^ sign) - sign) * scale + offset))
            else:
                values.append(floating.unpack(code.to_bytes(floating.size, "little"))[0] * scale + offset)
        return values


class PackPlan:
    """The payload of a message from the values of its signals, in the order of `fields`."""

    def __init__(self, fields: Sequence[BitField], length: int) -> None:
        self._fields = list(fields)
        self._length = length

    def data(self, values: Sequence[float]) -> bytes:
        """The payload, each value rounded to the nearest code; what no field covers is 0.

        Raises OutputRefused for a value that is not finite, or that the field or its range in the DBC does not hold.
        """
        big = little = 0
        for field, value in zip(self._fields, values, strict=True):
            if not math.isfinite(value):
                raise OutputRefused(f"{field.name} is {value}: nothing was sent")
            code: float = (value - field.offset) / field.scale
            floating = field.floating
            if floating is None:
                code = round(code)
            if not field.low <= code <= field.high:
                low, high = field.range
                raise OutputRefused(f"{field.name} is {value:g}, its frame holds {low:g} to {high:g}: nothing was sent")
            bits = int(code) & field.mask if floating is None else int.from_bytes(floating.pack(code), "little")
            if field.big_endian:
                big |= bits << field.shift
            else:
                little |= bits << field.shift
        data = little.to_bytes(self._length, "little")
        if big:
            data = (big | int.from_bytes(data, "big")).to_bytes(self._length, "big")
        return data
