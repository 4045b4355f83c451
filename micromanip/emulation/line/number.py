"""A number in a frame of a device that speaks by itself: what does not fit in it is the nearest that does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from micromanip.bus.number_options import NumberCodec


class LineNumber(NumberCodec):
    """value = scale x number + offset."""

    def __init__(self, keys: Any, scale: float | None = None) -> None:
        """`keys` are the driver's; `scale` is for those that have none."""
        super().__init__(keys)
        self.end: int = keys.end
        """The byte behind its last."""
        self._scale: float = getattr(keys, "scale", 1.0) if scale is None else scale
        self._offset: float = getattr(keys, "offset", 0.0)

    def put(self, frame: bytearray, value: float) -> None:
        """Write a value: the nearest that it can hold; NaN as such where the type has it, else as the largest code."""
        number = (value - self._offset) / self._scale
        if not self.floating:
            number = self.high if math.isnan(number) else round(min(max(number, self.low), self.high))
        self.write(frame, number)

    def get(self, frame: bytes) -> float:
        """Its value."""
        return self._scale * self.read(frame) + self._offset

    def code(self, frame: bytes) -> int:
        """It as a whole number, without scale."""
        return int(self.read(frame))


def optional_number(keys: Any) -> LineNumber | None:
    """The number that these keys of the driver describe, where the device may have none."""
    return None if keys is None else LineNumber(keys)


def line_numbers(keys: Mapping[str, Any]) -> dict[str, LineNumber]:
    """Several, by name."""
    return {name: LineNumber(number) for name, number in keys.items()}
