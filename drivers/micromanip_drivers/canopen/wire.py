"""Values to the bits of a PDO, and back: worked out once, when the driver is built."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from canopen.objectdictionary import datatypes

from micromanip.driver import OutputRefused

from .mapping import Mapped
from .options import InputSignal

_FLOATS = {datatypes.REAL32: struct.Struct("<f"), datatypes.REAL64: struct.Struct("<d")}


@dataclass(frozen=True)
class Wire:
    """One signal in a PDO, whose bytes are taken as one number, the first byte the lowest."""

    name: str
    shift: int
    mask: int
    sign: int
    """Weight of the sign bit; 0 for an unsigned one."""
    real: struct.Struct | None
    """How a floating-point number is packed; None for an integer."""
    lowest: int
    highest: int
    """Raw numbers that the wire and the EDS's limits allow; for an integer."""
    scale: float
    offset: float

    def value(self, frame: int) -> float:
        """The signal's value in a frame, taken as one number."""
        raw = frame >> self.shift & self.mask
        if self.real is not None:
            return float(self.real.unpack(raw.to_bytes(self.real.size, "little"))[0]) * self.scale + self.offset
        return ((raw ^ self.sign) - self.sign) * self.scale + self.offset

    def bits(self, value: float) -> int:
        """What to put into a frame for `value`. Raises OutputRefused if it is not finite or does not fit."""
        wanted = (value - self.offset) / self.scale
        if not math.isfinite(wanted):
            raise OutputRefused(f"{self.name} = {value}: an output is a finite number")
        if self.real is not None:
            try:
                raw = int.from_bytes(self.real.pack(wanted), "little")
            except OverflowError:
                raise OutputRefused(f"{self.name} = {value:g} is beyond what REAL32 can carry") from None
            return raw << self.shift
        raw = round(wanted)
        if not self.lowest <= raw <= self.highest:
            ends = sorted(limit * self.scale + self.offset for limit in (self.lowest, self.highest))
            raise OutputRefused(f"{self.name} = {value:g} does not fit: {ends[0]:g} to {ends[1]:g} do")
        return (raw & self.mask) << self.shift


def wire(name: str, mapped: Mapped, options: InputSignal) -> Wire:
    """How the signal `name` (for messages) travels as the object `mapped`."""
    variable, bits = mapped.variable, mapped.bits
    signed = variable.data_type in datatypes.SIGNED_TYPES
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return Wire(
        name=name,
        shift=mapped.first_bit,
        mask=(1 << bits) - 1,
        sign=1 << bits - 1 if signed else 0,
        real=_FLOATS.get(variable.data_type or 0),
        lowest=lowest if variable.min is None else max(lowest, variable.min),
        highest=highest if variable.max is None else min(highest, variable.max),
        scale=options.scale,
        offset=options.offset,
    )
