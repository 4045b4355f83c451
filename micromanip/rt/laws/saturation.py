"""Saturation: what an axis may request, and in which direction it is saturated.

`limit` is the last gate before any output, one small function that does not depend on the control law. Whatever is
requested, the result is finite, inside ``[low_V, high_V]`` and within ``slew_V`` of the voltage before (change per
cycle). Where the state does not permit motion the request is ignored and the output goes to ``park_V`` at the slew
limit. `previous_V` is this function's own last result; should it ever be outside the range, the range wins over the
slew.

A device may be behind: if its frames come back late, it gets no voltage further than a step from those that it may have
(``io/link_gate.py``); if its worker stands still, it gets none. A loop that does not know this asks for more and swings
from end to end, while the voltage hardly moves. So the driver, or the bus' exchange, replaces the requested voltage by
the given one, and set-point and voltage go no further in that direction, as at an end of the range (`hold_back`). They
may always go back.
"""

from __future__ import annotations

import math

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

LIMITER_PARAMETERS = record(("low_V", "f8"), ("high_V", "f8"), ("slew_V", "f8"), ("park_V", "f8"))


@compiled
def limit(p: Record, previous_V: float, requested_V: float, permitted: bool) -> float:
    """Voltage (V) that may be written, for `requested_V` after `previous_V`."""
    if not math.isfinite(previous_V):
        return p["park_V"]
    target = requested_V if permitted else p["park_V"]
    if not math.isfinite(target):
        target = previous_V
    if target > previous_V + p["slew_V"]:
        target = previous_V + p["slew_V"]
    if target < previous_V - p["slew_V"]:
        target = previous_V - p["slew_V"]
    if target > p["high_V"]:
        return p["high_V"]
    if target < p["low_V"]:
        return p["low_V"]
    return target


@compiled
def beyond(p: Record, requested_V: float) -> int:
    """1 or -1 if a request is beyond the upper or lower end of the range; else 0."""
    return int(requested_V > p["high_V"]) - int(requested_V < p["low_V"])


@compiled
def hold_back(behind: int, before: float, value: float) -> float:
    """`value`, but where the device is behind not beyond the one `before` in that direction (1: upwards, -1)."""
    if behind == 0:
        return value
    return min(before, value) if behind > 0 else max(before, value)


@compiled
def attainable(low: float, high: float, before: float, value: float) -> float:
    """`value` inside the range; from outside of it, as at rest, up to where it was `before`."""
    return max(min(low, before), min(max(high, before), value))


@compiled
def slewed(before: float, value: float, step: float) -> float:
    """`value`, or the nearest value within `step`."""
    if abs(value - before) <= step:
        return value
    return before + step if value > before else before - step
