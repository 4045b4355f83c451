"""Reading one signal of the process image: fresh or held, how old, plausible or not."""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

BELIEVED = 1000
"""Consecutive unusable cycles after which a jump is accepted as the new position: the sensor was moved."""
_END = 0.01
"""The ends of a range, as a share of it."""

SENSOR_STATE = record(
    ("value", "f8"),
    ("time_ns", "i8"),
    ("sequence", "i8"),
    ("arrived_ns", "i8"),
    ("taken_ns", "i8"),
    ("reading", "f8"),
    ("age_ns", "i8"),
    ("silent_ns", "i8"),
    ("fresh", "i8"),
    ("bad", "i8"),
    ("identical", "i8"),
    ("samples", "i8"),
    ("refused", "i8"),
    ("unseen", "i8"),
)


@compiled
def read_signal(signal: Record, s: Record, now_ns: int, max_age_ns: int, range_um: Any, rate_um_per_ns: float) -> bool:
    """Update sensor state `s` from `signal`; True for a fresh, good sample.

    ``value`` keeps the last good sample. ``bad`` counts consecutive cycles without a usable one: not finite, outside
    `range_um` (low, high), further from the last good one than `rate_um_per_ns` allows in the time since the one before
    was taken, or arrived, whichever is longer; flagged by the driver, never arrived, or older than `max_age_ns`. A
    sample taken after `now_ns`, the cycle's deadline, counts as of now. ``identical`` counts consecutive samples that
    read exactly the same. Of all that the device took since the first one here, ``samples`` were fresh and good,
    ``refused`` not, ``unseen`` never got here; if a driver restarts its sequence, these are unknown. ``silent_ns`` is
    the time since the measurement of the last sample that arrived, usable or not.
    """
    arrived = signal["sequence"] != s["sequence"]
    value = signal["value"]
    good = signal["status"] == 0 and math.isfinite(value) and range_um[0] <= value <= range_um[1]
    s["fresh"] = 0
    if arrived:
        taken_ns = min(signal["time_ns"], now_ns)
        if s["sequence"] > 0:
            s["unseen"] += max(0, signal["sequence"] - s["sequence"] - 1)
            if good and math.isfinite(rate_um_per_ns) and s["bad"] < BELIEVED:
                passed_ns = max(now_ns - s["arrived_ns"], taken_ns - s["taken_ns"])
                good = abs(value - s["value"]) <= rate_um_per_ns * passed_ns
        s["identical"] = s["identical"] + 1 if value == s["reading"] else 0
        s["sequence"] = signal["sequence"]
        s["reading"] = value
        s["arrived_ns"], s["taken_ns"] = now_ns, taken_ns
        if good:
            s["value"] = value
            s["time_ns"] = taken_ns
            s["fresh"] = 1
            s["samples"] += 1
        else:
            s["refused"] += 1
    s["silent_ns"] = now_ns - s["taken_ns"]
    s["age_ns"] = now_ns - s["time_ns"]
    if (arrived and not good) or s["sequence"] == 0 or s["age_ns"] > max_age_ns:
        s["bad"] += 1
    elif arrived:
        s["bad"] = 0
    return s["fresh"] == 1


@compiled
def read_sensor(
    place: int, signals: Any, s: Record, now_ns: int, max_age_ns: int, range_um: Any, rate_um_per_ns: float
) -> bool:
    """The same of the signal at `place` of the image; below 0 it is not wired, and left alone."""
    return place >= 0 and read_signal(signals[place], s, now_ns, max_age_ns, range_um, rate_um_per_ns)


@compiled
def is_silent(s: Record, longest_ns: int) -> bool:
    """Whether no sample of the last `longest_ns` has arrived, or no sample ever."""
    return s["sequence"] == 0 or s["silent_ns"] > longest_ns


@compiled
def may_be_at_end(s: Record, range_um: Any) -> bool:
    """Whether the reading is an unusable number, or at an end of the range: the true value may be beyond."""
    margin_um = _END * (range_um[1] - range_um[0])
    inside = range_um[0] + margin_um < s["reading"] < range_um[1] - margin_um
    return math.isfinite(s["reading"]) and (s["bad"] > 0 or not inside)
