"""Numbers in frames as values, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from micromanip.driver import OutputRefused
from micromanip.driver.wire import NumberCodec

from .frame_options import InputField, OutputField


class InputNumber:
    """A number of a frame as a value: scale x number + offset."""

    def __init__(self, options: InputField) -> None:
        self._codec = NumberCodec(options)
        self._scale, self._offset = options.scale, options.offset

    def value(self, data: bytes | bytearray, at: int = 0) -> float:
        """The value; not finite where a floating-point number is not."""
        return self._codec.read(data, at) * self._scale + self._offset


class OutputNumber:
    """A value as a number of a frame, with the range that it may have."""

    def __init__(self, name: str, options: OutputField) -> None:
        self._name = name
        self._codec = NumberCodec(options)
        self._scale, self._offset = options.scale, options.offset
        ends = sorted(end * options.scale + options.offset for end in (self._codec.low, self._codec.high))
        self._low, self._high = ends if options.range is None else options.range

    def put(self, data: bytearray, value: float) -> None:
        """Write `value`, rounded to the nearest number. Raises OutputRefused."""
        if not math.isfinite(value):
            raise OutputRefused(f"{self._name} is {value}: nothing was sent")
        number = (value - self._offset) / self._scale
        if not self._codec.floating and math.isfinite(number):  # a small scale may make it infinite
            number = round(number)
        if not (self._low <= value <= self._high and self._codec.low <= number <= self._codec.high):
            raise OutputRefused(
                f"{self._name} is {value:g}, it may be {self._low:g} to {self._high:g}: nothing was sent"
            )
        self._codec.write(data, number)


def mismatches(numbers: Mapping[str, tuple[NumberCodec, int]], data: bytes) -> Sequence[str]:
    """Which of the `numbers`, given with what they must be, are other ones in `data`: in words."""
    found = ((name, codec.read(data), wanted) for name, (codec, wanted) in numbers.items())
    return [f"{name} {number}, the configuration says {wanted}" for name, number, wanted in found if number != wanted]
