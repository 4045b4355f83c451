"""Numbers in a device: their keys (type, what value one stands for, what may be sent at most), and their bytes.

value = scale x number + offset.
"""

from __future__ import annotations

import math
import struct
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from micromanip.errors import ConfigError, did_you_mean
from micromanip.quantities import Range, Real, Scale

SIZES = {
    **{f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 24, 32, 64)},
    "float32": 4,
    "float64": 8,
}
"""Bytes of each type."""
PACKED = {"bool": 1, **{f"bit{bits}": bits for bits in range(2, 16) if bits != 8}}
"""Bits of the types that are no whole bytes, by their names in ETG.1020; unsigned."""
BITS = {**{kind: 8 * size for kind, size in SIZES.items()}, **PACKED}
"""Bits of each type of either kind."""
_CODES = {1: "b", 2: "h", 4: "i", 8: "q"}
_FLOATS = {"float32": "f", "float64": "d"}
_GREATEST = {"float32": (2.0 - 2.0**-23) * 2.0**127, "float64": (2.0 - 2.0**-52) * 2.0**1023}


def number_range(kind: str) -> tuple[float, float]:
    """Lowest and highest number that a type of `BITS` holds; of 64 bits the highest that is a double as well."""
    if kind in _GREATEST:
        return -_GREATEST[kind], _GREATEST[kind]
    bits = BITS[kind]
    lowest, highest = (0.0, 2.0**bits - 1) if kind[0] in "ub" else (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1)
    return lowest, math.nextafter(highest, 0.0) if bits == 64 else highest


class Section(BaseModel):
    """Keys of a section: unknown ones are refused, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Typed(Section):
    """A number of a type."""

    type: str = Field(description=f"One of {', '.join(SIZES)}.")

    @field_validator("type")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind not in SIZES:
            raise ValueError(f"there is no type {kind}; {did_you_mean(kind, SIZES, 'there are')}")
        return kind

    @property
    def size(self) -> int:
        """How many bytes it has."""
        return SIZES[self.type]


class Scaled(Section):
    """A number that stands for a value."""

    scale: Scale = Field(default=1.0, description="Physical unit per count: value = scale x number + offset.")
    offset: Real = Field(default=0.0, description="Value of the number 0.")


class Written(Section):
    """What is written over and over."""

    cyclic_safe: bool = Field(
        default=False, strict=True, description="The manual allows endless writing: it does not wear flash memory."
    )

    def must_last(self, key: str, rate_hz: float) -> None:
        """Raises ConfigError where nobody has said that it may be written at that rate; `key` is where it stands."""
        if not self.cyclic_safe:
            raise ConfigError(
                f"{key}cyclic_safe: {rate_hz:g} writes per second wear out a device that keeps them in flash memory; "
                "say cyclic_safe: true if its manual allows them for ever"
            )


class Commanded(Scaled):
    """A value sent to the device; `safe` must be within its range."""

    range: Range | None = Field(
        default=None, description="Lowest and highest value that may be sent; null: the type's."
    )
    safe: Real = Field(
        default=0.0,
        description="Value while the configuration does not use the output, and, in a driver in the loop, while the "
        "outputs do not follow the loop.",
    )

    @property
    def numbers(self) -> tuple[float, float]:
        """Lowest and highest number that it can be; text holds any."""
        return -math.inf, math.inf

    @model_validator(mode="after")
    def _safe_can_be_sent(self) -> Self:
        if self.range is not None and not self.range[0] <= self.safe <= self.range[1]:
            raise ValueError(f"safe {self.safe:g} is outside of the range {self.range[0]:g} to {self.range[1]:g}")
        low, high = self.numbers
        if not low <= round((self.safe - self.offset) / self.scale) <= high:
            ends = sorted(self.scale * end + self.offset for end in (low, high))
            raise ValueError(f"safe {self.safe:g} can't be sent: the number holds {ends[0]:g} to {ends[1]:g}")
        return self


class NumberCodec:
    """A number in frames: bytes to a number and back; `at` is where its frame begins in the bytes that it is given."""

    def __init__(self, options: Any) -> None:
        """`options` has the first byte ``at``, the ``size``, the ``type`` and its ``byte_order``, None for one byte."""
        self._at: int = options.at
        self._size: int = options.size
        self._order: Any = options.byte_order or "little"
        self._signed = options.type.startswith("int")
        self.floating = options.type.startswith("float")
        self._layout: struct.Struct | None = None
        order = "<" if self._order == "little" else ">"
        self.low, self.high = number_range(options.type)
        if self.floating:
            self._layout = struct.Struct(order + _FLOATS[options.type])
        elif self._size in _CODES:
            code = _CODES[self._size]
            self._layout = struct.Struct(order + (code if self._signed else code.upper()))

    def read(self, data: bytes | bytearray, at: int = 0) -> float:
        """The number; an int for a type that is one."""
        place = at + self._at
        if self._layout is not None:
            number: float = self._layout.unpack_from(data, place)[0]
            return number
        return int.from_bytes(data[place : place + self._size], self._order, signed=self._signed)

    def write(self, data: bytearray, number: float) -> None:
        """Put a number that the type holds into `data`."""
        if self._layout is not None:
            self._layout.pack_into(data, self._at, number if self.floating else int(number))
            return
        data[self._at : self._at + self._size] = int(number).to_bytes(self._size, self._order, signed=self._signed)

    @property
    def counts(self) -> int:
        """How many values an unsigned integer has before it wraps."""
        return 1 << (8 * self._size)
