"""Descriptions of frames by chance, and the same frames read and written by plain Python: struct, int, fastcrc."""

import math
import struct
from dataclasses import dataclass
from typing import Any

import fastcrc
from hypothesis import strategies as st

SIZES = {
    **{f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 24, 32, 64)},
    "float32": 4,
    "float64": 8,
}
CHECKSUMS = [
    f"crc{8 * size}.{name}"
    for size in (1, 2, 4, 8)
    for name in sorted(getattr(fastcrc, f"crc{8 * size}").algorithms_available)
]


@dataclass(frozen=True)
class Field:
    """A number as the configuration has it."""

    at: int
    type: str
    byte_order: str = "little"
    scale: float = 1.0
    offset: float = 0.0
    range: tuple[float, float] | None = None
    mask: int | None = None
    good: tuple[int, ...] = (0,)

    @property
    def size(self):
        return SIZES[self.type]

    @property
    def _floating(self):
        return ("<" if self.byte_order == "little" else ">") + {"float32": "f", "float64": "d"}[self.type]

    def code(self, frame):
        """The number, an int for a type that is one."""
        part = frame[self.at : self.at + self.size]
        if self.type.startswith("float"):
            return struct.unpack(self._floating, part)[0]
        return int.from_bytes(part, self.byte_order, signed=self.type.startswith("i"))

    def value(self, frame):
        return float(self.code(frame)) * self.scale + self.offset

    def ends(self):
        """Lowest and highest number; of 64 bits the highest that is a double as well."""
        if self.type.startswith("float"):
            greatest = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0] if self.size == 4 else math.nextafter(math.inf, 0)
            return -greatest, greatest
        bits = 8 * self.size
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if self.type.startswith("i") else (0, (1 << bits) - 1)
        return float(low), math.nextafter(float(high), 0) if self.size == 8 else float(high)

    def put(self, frame, value):
        """Write a value into a bytearray; False where it may not be sent."""
        if not math.isfinite(value):
            return False
        number = (value - self.offset) / self.scale
        low, high = self.ends()
        if not self.type.startswith("float"):
            if not math.isfinite(number):
                return False
            number = round(number)
        least, most = self.range or sorted(end * self.scale + self.offset for end in (low, high))
        if not (least <= value <= most and low <= number <= high):
            return False
        if self.type.startswith("float"):
            frame[self.at : self.at + self.size] = struct.pack(self._floating, number)
        else:
            signed = self.type.startswith("i")
            frame[self.at : self.at + self.size] = number.to_bytes(self.size, self.byte_order, signed=signed)
        return True

    def word(self, frame):
        """It as a status: 0 is good."""
        found = self.code(frame) & ((1 << (8 * self.size)) - 1 if self.mask is None else self.mask)
        if found in self.good:
            return 0
        return (found - (1 << 64) if found >> 63 else found) or -1


@dataclass(frozen=True)
class Checksum:
    """A checksum as the configuration has it."""

    name: str
    first: int = 0
    byte_order: str = "little"

    @property
    def size(self):
        return int(self.name.split(".")[0][3:]) // 8

    @property
    def function(self):
        width, name = self.name.split(".")
        return getattr(getattr(fastcrc, width), name)

    def of(self, frame):
        """The bytes that belong at the end of `frame`, which has room for them."""
        return self.function(bytes(frame[self.first : len(frame) - self.size])).to_bytes(self.size, self.byte_order)


_scales = st.floats(1e-9, 1e9) | st.floats(-1e9, -1e-9) | st.sampled_from([1.0, -1.0, 1e-4, 0.005])
_orders = st.sampled_from(["little", "big"])


@st.composite
def frame_descriptions(draw: Any):
    """Head, counter, status and fields one behind the other with gaps, then a checksum, and the frame's length."""
    head = draw(st.binary(max_size=4))
    at = len(head)

    def placed(kinds, **keys):
        nonlocal at
        kind = draw(st.sampled_from(kinds))
        at += draw(st.integers(0, 2))
        field = Field(at, kind, draw(_orders), **keys)
        at += field.size
        return field

    whole = [kind for kind in SIZES if kind.startswith("uint")]
    counter = placed(whole) if draw(st.booleans()) else None
    status = None
    if draw(st.booleans()):
        status = placed(
            whole,
            mask=draw(st.none() | st.integers(1, 2**64 - 1)),
            good=tuple(draw(st.lists(st.integers(0, 2**64 - 1) | st.integers(0, 3), min_size=1, max_size=4))),
        )
    fields = []
    for _ in range(draw(st.integers(1, 6))):
        bounds = draw(st.none() | st.tuples(st.floats(-1e6, 1e6), st.floats(0, 1e6)))
        limits = None if bounds is None else (bounds[0], bounds[0] + bounds[1])
        offset = draw(st.floats(-1e6, 1e6))
        fields.append(placed(list(SIZES), scale=draw(_scales), offset=offset, range=limits))
    at += draw(st.integers(0, 3))
    check = None
    if draw(st.booleans()):
        check = Checksum(draw(st.sampled_from(CHECKSUMS)), draw(st.integers(0, at)), draw(_orders))
        at += check.size
    return head, counter, status, fields, check, at
