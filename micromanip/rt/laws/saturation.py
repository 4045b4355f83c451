"""Saturation: what an axis may ask for, and in which direction no more is to be had.

`limit` is the last gate before any output, one small function that knows nothing of the control law. Whatever is
requested, the result is finite, inside ``[low_V, high_V]`` and within ``slew_V`` of the voltage before (change per
cycle). Where the state does not permit motion the request is ignored and the output goes to ``park_V`` at the slew
limit. `previous_V` is this function's own last result; should it ever be outside the range, the range wins over the
slew.

A device may be behind: one whose frames come back late gets no voltage further than a step from those that it may
have (``io/link_gate.py``), and one behind a worker that stands still gets none. A loop that does not know asks for
more, and swings from end to end behind a voltage that hardly moves. So the driver, or the bus' exchange, puts what was
given in place of what was asked, and the axis goes no further in that direction, as at an end of its range: neither
set-point nor voltage (`hold_back`). Back they go as ever.
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
    """1 or -1 where a request is beyond the upper or lower end of the range, where no more is to be had; else 0."""
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
    """`value`, or as near to it as `step` leads."""
    if abs(value - before) <= step:
        return value
    return before + step if value > before else before - step
