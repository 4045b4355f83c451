"""The last gate before any output: one small function that knows nothing of the control law.

Whatever is requested, the result is finite, inside ``[low_V, high_V]`` and within ``slew_V`` of
the voltage before (change per cycle). Where the state does not permit motion the request is
ignored and the output goes to ``park_V`` at the slew limit. `previous_V` is this function's own
last result; should it ever be outside the range, the range wins over the slew.
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
