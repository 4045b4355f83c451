"""Frames taken apart and put together: plans that are made once, from the DBC, and cost a shift and a mask a signal.

cantools gives the layouts, and is what the tests compare with; it takes several times as long for each frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import can
import numpy as np

from micromanip.driver import TransientError

from ..sent_number import sent_number
from .bit_field import BitField


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
        **flags: bool,
    ) -> None:
        """`counter` is incremented with each; `flags` are python-can's."""
        self.identity, self.length, self.fields, self.counter = identity, len(data), fields, counter
        self.indices = tuple(range(first, first + len(fields)))
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
            self._counting["count"] = (int(self._counting["count"]) + 1) & self.counter.mask
