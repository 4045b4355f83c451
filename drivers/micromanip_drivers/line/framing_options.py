"""Keys that the framings `binary` and `stream` share: checksum, length, counter, identity."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from typing import Annotated

import fastcrc
from pydantic import Field, field_validator

from .field_options import ByteOrder, WholeNumber
from .section import Place, Section, Whole

_WIDTHS = {"crc8": 1, "crc16": 2, "crc32": 4, "crc64": 8}
CRC_NAMES = [f"{width}.{name}" for width in _WIDTHS for name in sorted(getattr(fastcrc, width).algorithms_available)]


class Crc(Section):
    """A checksum; it is the last of the frame."""

    name: str = Field(description="As fastcrc calls it: crc16.modbus, crc16.ibm_3740, crc32.iso_hdlc, crc8.smbus, ...")
    byte_order: ByteOrder = Field(default="little", description="Which of its bytes comes first.")
    first: Place = Field(default=0, description="First byte that it covers; it covers all from there on.")

    @field_validator("name")
    @classmethod
    def _is_known(cls, name: str) -> str:
        if name not in CRC_NAMES:
            near = difflib.get_close_matches(name.lower().replace("-", "_").replace("/", "."), CRC_NAMES, 3)
            hint = f"did you mean {', '.join(near)}?" if near else "its documentation lists them, e.g. crc16.modbus"
            raise ValueError(f"fastcrc has no {name}: {hint}")
        return name

    @property
    def size(self) -> int:
        """How many bytes it has."""
        return _WIDTHS[self.name.split(".")[0]]

    @property
    def function(self) -> Callable[[bytes], int]:
        """From the bytes that it covers to the checksum."""
        width, name = self.name.split(".")
        function: Callable[[bytes], int] = getattr(getattr(fastcrc, width), name)
        return function


class Length(WholeNumber):
    """A number in the frame that says how long it is."""

    plus: Annotated[Whole, Field(ge=-65_535, le=65_535)] = Field(
        default=0, description="Bytes of the frame that it does not count: the frame has so many more than it says."
    )


class Counter(WholeNumber):
    """A number that the sender increments with each frame; it wraps at the end of its type."""
