"""Where signals lie in frames, taken apart and put together: plans that are made once, from the DBC.

They cost a shift and a mask a signal. cantools gives the layouts, and is what the tests compare with; it takes several
times as long for each frame.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import can
import numpy as np

from micromanip.driver import TransientError

from ..sent_number import sent_number

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


class Layout:
    """Signals in a frame: its identifier, with whether that has 29 bits, and the bytes of its data."""

    identity: tuple[int, bool]
    length: int
    fields: Sequence[BitField]


class Incoming(Layout):
    """A frame that is received: how old its values are then, and which input is its first signal."""

    title: str
    """For messages."""
    latency_ns: int
    first: int
    short = 0
    """How often it came with too few bytes."""

    def whole(self, data: bytes | bytearray) -> bytes | bytearray:
        """Its bytes. Raises TransientError for a frame that is too short."""
        if len(data) < self.length:
            self.short += 1
            raise TransientError(f"{self.title} came with {len(data)} bytes instead of {self.length}")
        return data[: self.length]


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
            floating, held = field.floating, (field.low, field.high)
            code = sent_number(value, field.name, field.scale, field.offset, held, None, floating is None)
            bits = int(code) & field.mask if floating is None else int.from_bytes(floating.pack(code), "little")
            if field.big_endian:
                big |= bits << field.shift
            else:
                little |= bits << field.shift
        data = little.to_bytes(self._length, "little")
        if big:
            data = (big | int.from_bytes(data, "big")).to_bytes(self._length, "big")
        return data


class Outgoing(Layout):
    """A frame that is sent: `data`, or values of outputs in its `fields`, the first of them at index `first`."""

    def __init__(
        self,
        identity: tuple[int, bool],
        data: bytes,
        fields: Sequence[BitField] = (),
        first: int = 0,
        counter: BitField | None = None,
        counts: int = 0,
        **flags: bool,
    ) -> None:
        """`counter` is incremented with each, to 0 after `counts`; `flags` are python-can's."""
        self.identity, self.length, self.fields, self.counter = identity, len(data), fields, counter
        self.counts, self.indices = counts, tuple(range(first, first + len(fields)))
        self._head: dict[str, Any] = {"arbitration_id": identity[0], "is_extended_id": identity[1], **flags}
        self._data, self._own = data, slice(first, first + len(fields))
        self._counting = np.zeros(1, [("count", "i8")])[0]
        self._plan = PackPlan([*fields, *([counter] if counter else [])], len(data))

    def frame(self, values: Sequence[float]) -> can.Message:
        """The next frame, with `values` of all outputs of the driver. Raises OutputRefused.

        Its counter stays until `was_sent`: a frame that the interface did not take leaves no gap.
        """
        own = values[self._own]
        if self.counter is not None:
            own = [*own, int(self._counting["count"])]
        return can.Message(data=self._plan.data(own) if len(own) else self._data, **self._head)

    def empty(self) -> can.Message:
        """It, before anything is written into it."""
        return can.Message(data=self._data, **self._head)

    def count_in(self, record: Any) -> None:
        """Keep the counter in `record` from now on, where compiled code goes on with it."""
        record["count"] = self._counting["count"]
        self._counting = record

    def was_sent(self) -> None:
        """The last frame is on its way: count on."""
        if self.counter is not None:
            self._counting["count"] = (int(self._counting["count"]) + 1) % self.counts
