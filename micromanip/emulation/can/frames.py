"""Messages of a DBC as tables for compiled code: which bits of a frame are a signal, and which value they are.

The bits are looked up one by one, as a DBC numbers them: not by the shifts of the driver, which the device is to check.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from micromanip.rt.record import record
from micromanip.rt.wire.numbers import find_code, value_of_code
from micromanip.rt.wire.records import CODE, FLOATING, SIGNED, UNSIGNED

from ..arrivals import ARRIVED
from ..compiled import compiled

MAX_BITS = 64
_EXACT_BITS = 53
HEADER, STAMP_BYTES = 8, 8
"""Bytes of a frame before its data, and of the time before the frame."""
FIRST, PACKET_BYTES = STAMP_BYTES + HEADER, 80
ZERO, ONE = -1, -2
"""Channels of a signal that nobody measures, and of an amplifier's "ok" that the plant has not."""

FIELD = record(
    ("bits", "i8"),
    ("place", "i2", (MAX_BITS,)),
    *CODE,
    ("low", "f8"),
    ("high", "f8"),
    ("channel", "i8"),
    ("arrived", ARRIVED),
)
"""A signal: bit j of its code is number ``place[j]`` of the data, 8 x byte + bit. `low` and `high` are what its bits
hold, `channel` is the plant's input that fills it or its output that takes it, `arrived` what that was given."""


@compiled
def code_at(f: Any, data: Any, first: int) -> Any:
    """The code (uint64) in the data that begins at `first`."""
    code = np.uint64(0)
    for j in range(f["bits"]):
        at = f["place"][j]
        code |= np.uint64((data[first + (at >> 3)] >> (at & 7)) & 1) << np.uint64(j)
    return code


@compiled
def put_code(f: Any, data: Any, first: int, code: Any) -> None:
    """Write a code into data that is 0 there."""
    for j in range(f["bits"]):
        at = f["place"][j]
        data[first + (at >> 3)] |= np.uint8(((code >> np.uint64(j)) & np.uint64(1)) << np.uint64(at & 7))


@compiled
def value_at(f: Any, data: Any, first: int, scratch: Any) -> float:
    """The value in the data; `scratch` is uint64 (1,)."""
    return value_of_code(f, code_at(f, data, first), f["bits"], scratch)


@compiled
def put_nearest(f: Any, data: Any, first: int, value: float, scratch: Any) -> bool:
    """Write `value`, or the nearest that the bits hold, into data that is 0 there; False for what is not finite."""
    if not math.isfinite(value) or not find_code(f, max(f["low"], min(f["high"], value)), f["bits"], scratch):
        return False
    put_code(f, data, first, scratch[0])
    return True


def has_tables(message: Any) -> bool:
    """Whether compiled code can code all signals of a message of cantools exactly."""
    return all(signal.is_float or signal.length <= _EXACT_BITS for signal in message.signals)


def fill_field(row: Any, signal: Any, ends: tuple[float, float, bool], channel: int) -> None:
    """Describe a signal of cantools, which may have any value between the first two of `ends`."""
    row["bits"] = signal.length
    row["place"][: signal.length] = list(_places(signal))
    row["scale"], row["offset"] = signal.scale, signal.offset
    row["low"], row["high"] = ends[:2]
    row["kind"] = FLOATING if signal.is_float else SIGNED if signal.is_signed else UNSIGNED
    half = 1 << signal.length - 1
    codes = (-math.inf, math.inf) if signal.is_float else (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)
    row["lowest_code"], row["highest_code"] = codes
    row["channel"] = channel
    row["arrived"]["last"] = math.nan


def _places(signal: Any) -> Iterator[int]:
    """Of its bits, the lowest first. A DBC says where the lowest is, or of Motorola's byte order the highest."""
    if signal.byte_order == "little_endian":
        yield from range(signal.start, signal.start + signal.length)
        return
    place, places = signal.start, []
    for _ in range(signal.length):
        places.append(place)
        place += -1 if place % 8 else 15
    yield from reversed(places)
