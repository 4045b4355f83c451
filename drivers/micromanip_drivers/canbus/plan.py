"""Frames taken apart and put together: plans that are made once, from the DBC, and cost a shift and a mask a signal.

cantools gives the layouts, and is what the tests compare with; it takes several times as long for each frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import can

from micromanip.driver import OutputRefused

from .bit_field import BitField


class Layout:
    """Signals in a frame: its identifier, with whether that has 29 bits, and the bytes of its data."""

    identity: tuple[int, bool]
    length: int
    fields: Sequence[BitField]


class Incoming(Layout):
    """A frame that is received: how old its values are then, and which input is its first signal."""

    latency_ns: int
    first: int


class Outgoing(Layout):
    """A frame that is sent, with the outputs that are its signals, one after the other."""

    indices: tuple[int, ...]

    def empty(self) -> can.Message:
        """It, before anything is written into it."""
        raise NotImplementedError


class UnpackPlan:
    """Values of some signals of a message, in the order of `fields`."""

    def __init__(self, fields: Sequence[BitField]) -> None:
        orders = {field.big_endian for field in fields}
        self._plain = len(orders) < 2 and not any(field.floating for field in fields)
        self._order: Literal["big", "little"] = "big" if True in orders else "little"
        self._rows = [(field.shift, field.mask, field.sign, field.scale, field.offset, field) for field in fields]

    def codes(self, data: bytes | bytearray) -> list[int]:
        """What the bits say, before scale and offset; `data` has the length of the message."""
        return [((_number(data, field) >> shift & mask) ^ sign) - sign for shift, mask, sign, _, _, field in self._rows]

    def values(self, data: bytes | bytearray) -> list[float]:
        """The values; `data` has the length of the message."""
        if not self._plain:
            return [_value(data, field) for *_, field in self._rows]
        whole = int.from_bytes(data, self._order)
        return [
            (((whole >> shift & mask) ^ sign) - sign) * scale + offset
            for shift, mask, sign, scale, offset, _ in self._rows
        ]


def _number(data: bytes | bytearray, field: BitField) -> int:
    """The frame as one number, in the byte order of a field."""
    return int.from_bytes(data, "big" if field.big_endian else "little")


def _value(data: bytes | bytearray, field: BitField) -> float:
    """One value, whatever the field."""
    code = _number(data, field) >> field.shift & field.mask
    if field.floating is None:
        return float(((code ^ field.sign) - field.sign) * field.scale + field.offset)
    return float(field.floating.unpack(code.to_bytes(field.floating.size, "little"))[0] * field.scale + field.offset)


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
