"""Reading a digital input of the process image: a line, or a whole number that a machine says."""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

LINE_PARAMETERS = record(("signal", "i8"), ("age_ns", "i8"))
"""Its place in the image (-1: not wired), and how old it may be."""
LINE_STATE = record(("value", "f8"), ("time_ns", "i8"), ("sequence", "i8"), ("bad", "i8"))
"""The last good sample; ``bad`` is 0 while that may be trusted."""


@compiled
def read_line(line: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Update the state `s`; an input that is not wired is left alone."""
    if line["signal"] >= 0:
        take_sample(line, s, signals[line["signal"]], now_ns)


@compiled.called
def take_sample(line: Record, s: Record, signal: Record, now_ns: int) -> None:
    """Not trusted is one that is not finite, flagged by its driver, older than it may be, or that never came."""
    arrived, good = signal["sequence"] != s["sequence"], signal["status"] == 0 and math.isfinite(signal["value"])
    if arrived and good:
        s["value"], s["time_ns"] = signal["value"], min(signal["time_ns"], now_ns)
    s["sequence"] = signal["sequence"]
    if (arrived and not good) or s["sequence"] == 0 or now_ns - s["time_ns"] > line["age_ns"]:
        s["bad"] = 1
    elif arrived:
        s["bad"] = 0


@compiled
def is_on(line: Record, s: Record) -> bool:
    """Whether it says 1, by a sample that may be trusted."""
    return line["signal"] >= 0 and s["bad"] == 0 and s["value"] > 0.5


@compiled
def is_missing(line: Record, s: Record) -> bool:
    """Whether one that is wired does not say 1: a broken wire counts as 0."""
    return line["signal"] >= 0 and not is_on(line, s)


@compiled
def digital_value(s: Record, most: int) -> int:
    """The whole number that it says, `most` where it says more; 0 where that is not to be trusted."""
    if s["bad"] != 0:
        return 0
    return int(min(float(most), max(0.0, s["value"])) + 0.5)
