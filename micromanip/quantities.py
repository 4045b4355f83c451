"""Numbers as people write them: a type a unit, with the bounds that it has wherever it is written.

The file, `set`, the control socket, the options of the drivers and the command line take these types, so what one of
them refuses none of them takes. The bounds are generous: they keep out slips, and what no calculation survives (1e300),
not unusual machines. A narrower bound that only one key needs stands at that key.
"""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field, ValidationInfo

Number = TypeVar("Number", int, float)

Seconds = Annotated[float, Field(strict=True, ge=1e-6, le=86_400, allow_inf_nan=False)]
SecondsOrZero = Annotated[float, Field(strict=True, ge=0, le=86_400, allow_inf_nan=False)]
RampSeconds = Annotated[float, Field(strict=True, ge=1e-3, le=3_600, allow_inf_nan=False)]
"""A time in which something moves: never at once."""
Duration = Annotated[float, Field(strict=True, ge=0.1, le=31_536_000, allow_inf_nan=False)]
"""Seconds for which something is to run."""
Milliseconds = Annotated[float, Field(strict=True, ge=1e-3, le=3_600_000, allow_inf_nan=False)]
MillisecondsOrZero = Annotated[float, Field(strict=True, ge=0, le=3_600_000, allow_inf_nan=False)]
Microseconds = Annotated[float, Field(strict=True, ge=1, le=3_600_000_000, allow_inf_nan=False)]
MicrosecondsOrZero = Annotated[float, Field(strict=True, ge=0, le=1_000_000, allow_inf_nan=False)]

Micrometres = Annotated[float, Field(strict=True, ge=-10_000, le=10_000, allow_inf_nan=False)]
Distance = Annotated[float, Field(strict=True, ge=1e-9, le=10_000, allow_inf_nan=False)]
"""Micrometres above 0: a limit, an rms."""
DistanceOrZero = Annotated[float, Field(strict=True, ge=0, le=10_000, allow_inf_nan=False)]
Volts = Annotated[float, Field(strict=True, ge=-10_000, le=10_000, allow_inf_nan=False)]
VoltsAboveZero = Annotated[float, Field(strict=True, ge=1e-6, le=10_000, allow_inf_nan=False)]
Speed = Annotated[float, Field(strict=True, ge=1e-6, le=1_000_000, allow_inf_nan=False)]
"""Of whatever changes: um/ms, um/s, V/ms."""
Hertz = Annotated[float, Field(strict=True, ge=1e-6, le=1_000_000, allow_inf_nan=False)]
Degrees = Annotated[float, Field(strict=True, ge=-360_000, le=360_000, allow_inf_nan=False)]
Percent = Annotated[float, Field(strict=True, gt=0, le=100, allow_inf_nan=False)]

Real = Annotated[float, Field(strict=True, ge=-1_000_000_000_000, le=1_000_000_000_000, allow_inf_nan=False)]
"""A coefficient without a unit of its own."""
Positive = Annotated[float, Field(strict=True, ge=1e-9, le=1_000_000_000, allow_inf_nan=False)]
"""A gain, a weight, a ratio."""
NotNegative = Annotated[float, Field(strict=True, ge=0, le=1_000_000_000, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=1, le=1_000_000)]
Seed = Annotated[int, Field(strict=True, ge=0, le=2**32 - 1)]


def _rising(pair: tuple[Number, Number], info: ValidationInfo) -> tuple[Number, Number]:
    if pair[0] >= pair[1]:
        name, ends = info.field_name or "a range", list(pair)
        advice = "" if pair[0] == pair[1] else f", e.g. {[pair[1], pair[0]]}"
        raise ValueError(f"{name} must rise{advice}, not {ends}")
    return pair


Rising = AfterValidator(_rising)
"""Of a pair: its first number is the lower one."""
RangeUm = Annotated[tuple[Micrometres, Micrometres], Rising]
RangeV = Annotated[tuple[Volts, Volts], Rising]
RangeHz = Annotated[tuple[Hertz, Hertz], Rising]
Range = Annotated[tuple[Real, Real], Rising]


def _not_tiny(scale: float) -> float:
    if scale == 0.0:
        raise ValueError("a scale of 0 makes every value the same")
    if abs(scale) < 1e-12:
        raise ValueError(f"{scale:g} is no scale: at least 1e-12, or no value could be written as a number")
    return scale


Scale = Annotated[Real, AfterValidator(_not_tiny)]
"""Of a device's number."""
SampleRate = Annotated[float, Field(strict=True, ge=1e-3, le=20_000, allow_inf_nan=False)]
"""Hertz; no bus is faster than the fastest loop."""
Latency = Annotated[float, Field(strict=True, ge=0, le=1_000_000, allow_inf_nan=False)]
"""Microseconds."""
