"""Where a signal lies in a PDO, and how its code becomes a number: what mapping, EDS and configuration say."""

from __future__ import annotations

import struct

from canopen.objectdictionary import datatypes

from ..canbus.bit_field import GREATEST, BitField
from .mapping import Mapped
from .options import InputSignal

_FLOATS = {datatypes.REAL32: struct.Struct("<f"), datatypes.REAL64: struct.Struct("<d")}


def wire(name: str, mapped: Mapped, options: InputSignal) -> BitField:
    """How the signal `name` (for messages) travels as the object `mapped`."""
    variable, bits = mapped.variable, mapped.bits
    signed, floating = variable.data_type in datatypes.SIGNED_TYPES, _FLOATS.get(variable.data_type or 0)
    low: float
    high: float
    if floating is not None:
        low, high = -GREATEST[bits], GREATEST[bits]
    else:
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        low = low if variable.min is None else max(low, variable.min)
        high = high if variable.max is None else min(high, variable.max)
    return BitField(
        name=name,
        big_endian=False,
        shift=mapped.first_bit,
        bits=bits,
        sign=1 << bits - 1 if signed else 0,
        floating=floating,
        scale=options.scale,
        offset=options.offset,
        low=low,
        high=high,
    )
