"""Keys of frames: a number in one and how its bytes become a value, checksum, length, counter. Nothing is guessed.

`at` counts bytes from the first of the frame (of the block, in a stream's blocks), beginning with 0.
value = scale x number + offset.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable
from typing import Annotated, Literal

import fastcrc
from pydantic import AfterValidator, Field, field_validator, model_validator

from micromanip.driver import Commanded, Scaled, Section, Typed, did_you_mean, number_range


def _hexadecimal(text: str) -> str:
    try:
        bytes.fromhex(text)
    except ValueError:
        raise ValueError(f'"{text}" is not hexadecimal: two digits a byte, for example "aa 55"') from None
    return text


HexBytes = Annotated[str, AfterValidator(_hexadecimal)]
"""Bytes as hexadecimal text, blanks between them or not."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Place = Annotated[int, Field(strict=True, ge=0, le=65_535)]
Count = Annotated[int, Field(strict=True, ge=1, le=65_535)]
BAD = -1
"""Status of a sample that is no number, or whose device says 0 and 0 is not good."""
Whole = Annotated[int, Field(strict=True, ge=-(2**63), le=2**64 - 1)]


ByteOrder = Literal["little", "big"]
_WIDTHS = {"crc8": 1, "crc16": 2, "crc32": 4, "crc64": 8}
_CHECKSUMS: dict[str, tuple[int, Callable[[bytes], int]]] = {
    **{
        f"{width}.{name}": (size, getattr(getattr(fastcrc, width), name))
        for width, size in _WIDTHS.items()
        for name in sorted(getattr(fastcrc, width).algorithms_available)
    },
    "xor8": (1, lambda covered: functools.reduce(operator.xor, covered, 0)),
    "sum8": (1, lambda covered: sum(covered) & 0xFF),
    "lrc8": (1, lambda covered: -sum(covered) & 0xFF),
    "sum16": (2, lambda covered: sum(covered) & 0xFFFF),
}
"""Bytes that it has, and what it makes of those that it covers."""


class Number(Typed):
    """A number in a frame."""

    at: Place = Field(description="First byte, from 0, in the frame or block.")
    byte_order: ByteOrder | None = Field(
        default=None,
        description="little: lowest byte first; big: highest. null: a single byte.",
    )

    @model_validator(mode="after")
    def _order_is_given(self) -> Number:
        if self.byte_order is None and self.size > 1:
            raise ValueError(f"byte_order must be given for {self.type}: little or big, as the device's manual says")
        return self

    @property
    def end(self) -> int:
        """The byte behind its last."""
        return self.at + self.size


class WholeNumber(Number):
    """A counter or a state: unsigned."""

    @model_validator(mode="after")
    def _is_whole(self) -> WholeNumber:
        if not self.type.startswith("uint"):
            raise ValueError(f"must be one of uint8, uint16, uint24, uint32, uint64, not {self.type}")
        return self


class Status(WholeNumber):
    """A number that marks the device's values as valid."""

    mask: Annotated[int, Field(strict=True, ge=1)] | None = Field(
        default=None, description="Bits that count; null: all."
    )
    good: tuple[Annotated[int, Field(strict=True, ge=0)], ...] = Field(
        default=(0,), min_length=1, description="Good values under the mask."
    )


class Known(Number):
    """A number that identifies the device: a type, a serial number."""

    value: Whole = Field(description="Expected value; any other is the wrong device.")

    @model_validator(mode="after")
    def _is_an_integer(self) -> Known:
        if self.type.startswith("float"):
            raise ValueError("an identity is a whole number")
        return self


class InputField(Scaled, Number):
    """A value from the device."""


class OutputField(Commanded, InputField):
    """A value to the device."""

    @property
    def numbers(self) -> tuple[float, float]:
        return number_range(self.type)


def overlap(parts: Iterable[tuple[str, int, int]]) -> str | None:
    """What is wrong if two of the `parts` (name, first byte, byte behind the last) share a byte; None if none do."""
    last = ("", 0, 0)
    for part in sorted(parts, key=lambda part: part[1:]):
        if part[1] < last[2]:
            return f"{last[0]} (bytes {last[1]} to {last[2] - 1}) and {part[0]} (from byte {part[1]}) overlap"
        last = part
    return None


class Crc(Section):
    """A checksum at the end of the frame."""

    name: str = Field(
        description="Name in fastcrc: crc16.modbus, crc32.iso_hdlc, crc8.smbus, ...; or xor8, sum8, sum16, and lrc8, "
        "which makes the sum of all bytes 0."
    )
    byte_order: ByteOrder = Field(default="little", description="Order of its bytes.")
    first: Place = Field(default=0, description="First byte covered; all following are, too.")

    @field_validator("name")
    @classmethod
    def _is_known(cls, name: str) -> str:
        if name not in _CHECKSUMS:
            known = name.lower().replace("-", "_").replace("/", ".")
            raise ValueError(f"there is no checksum {name}; {did_you_mean(known, _CHECKSUMS)}")
        return name

    @property
    def size(self) -> int:
        """How many bytes it has."""
        return _CHECKSUMS[self.name][0]

    @property
    def function(self) -> Callable[[bytes], int]:
        """From the bytes that it covers to the checksum."""
        return _CHECKSUMS[self.name][1]

    def of(self, frame: bytes) -> bytes:
        """The checksum of a frame that has none yet."""
        return self.function(frame[self.first :]).to_bytes(self.size, self.byte_order)

    def fits(self, frame: bytes) -> bool:
        """Whether a whole frame is good."""
        return len(frame) > self.size and self.of(frame[: -self.size]) == frame[-self.size :]


class Length(WholeNumber):
    """A number in the frame: its length."""

    plus: Annotated[Whole, Field(ge=-65_535, le=65_535)] = Field(
        default=0, description="Bytes that the number does not count."
    )


class Counter(WholeNumber):
    """A number that the sender increments with each frame; it wraps at the end of its type."""
