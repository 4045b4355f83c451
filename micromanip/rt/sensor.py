"""Reading one signal of the process image: fresh or held, how old, plausible or not."""

from __future__ import annotations

import math
from typing import Any

from .jit import compiled
from .records import Record


@compiled
def read_signal(signal: Record, s: Record, now_ns: int, max_age_ns: int, range_um: Any) -> bool:
    """Update sensor state `s` from `signal`; True for a fresh, good sample.

    ``value`` keeps the last good sample. ``bad`` counts cycles in a row without a usable one: not finite,
    outside `range_um` (low, high), flagged by the driver, never arrived, or older than `max_age_ns`. ``lost``
    counts samples that came and went unseen; a driver that starts its sequence over has lost none.
    """
    arrived = signal["sequence"] != s["sequence"]
    value = signal["value"]
    good = signal["status"] == 0 and math.isfinite(value) and range_um[0] <= value <= range_um[1]
    s["fresh"] = 0
    if arrived:
        if s["sequence"] > 0:
            s["lost"] += max(0, signal["sequence"] - s["sequence"] - 1)
        s["sequence"] = signal["sequence"]
        if good:
            s["value"] = value
            s["time_ns"] = signal["time_ns"]
            s["fresh"] = 1
    s["age_ns"] = now_ns - s["time_ns"]
    if (arrived and not good) or s["sequence"] == 0 or s["age_ns"] > max_age_ns:
        s["bad"] += 1
    elif arrived:
        s["bad"] = 0
    return s["fresh"] == 1
