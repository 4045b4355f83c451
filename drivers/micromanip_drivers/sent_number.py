"""A value on its way to a device: the number that stands for it, or a refusal."""

from __future__ import annotations

import math

from micromanip.driver import OutputRefused

ANY = (-math.inf, math.inf)


def sent_number(
    value: float,
    name: str,
    scale: float,
    offset: float,
    numbers: tuple[float, float],
    limits: tuple[float, float] | None,
    whole: bool,
) -> float:
    """The number that stands for `value` (value = scale x number + offset), rounded where it must be `whole`.

    Raises OutputRefused for a value that is not finite or outside of `limits`, and for one whose number lies outside of
    the `numbers` that the device can be given.
    """
    if not math.isfinite(value):
        raise OutputRefused(f"{name} is {value}: nothing was sent")
    number = (value - offset) / scale
    low, high = limits or ANY
    if math.isfinite(number) and low <= value <= high:  # a small scale may make it infinite
        number = round(number) if whole else number
        if numbers[0] <= number <= numbers[1]:
            return number
    ends = sorted(scale * end + offset for end in numbers)
    low, high = max(low, ends[0]), min(high, ends[1])
    raise OutputRefused(f"{name} is {value:g}, it may be {low:g} to {high:g}: nothing was sent")
