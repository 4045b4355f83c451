"""Digital signals of the machine: amplifier, feed-hold, heartbeat; which part it makes, and with which tool.

Each is a binary line, or a whole number from the machine.

The signal ``part`` is 0 while no part is made, and any other number during a part: a line that is 1, or a counter. A
part begins in the cycle in which the number changes, and ends with the next change; an unusable signal counts as 0.
Without that signal a part begins and ends by command, or ends when the cell stops tracking.

The signal ``tool`` is the number of the tool in the spindle, 0 for none. An unusable signal, or another value, counts
as 0. Without the signal the tool is 0.
"""

from __future__ import annotations

import math
from typing import Any

from .jit import compiled
from .record import Record, record
from .states import ARMING, HOLDING, NO_FAULT, RAMPING, READY, TRACKING

LINE_PARAMETERS = record(("signal", "i8"), ("age_ns", "i8"))
"""Its place in the image (-1: not wired), and how old it may be."""
LINE_STATE = record(("value", "f8"), ("time_ns", "i8"), ("sequence", "i8"), ("bad", "i8"))
"""The last good sample; ``bad`` is 0 while that may be trusted."""

_MOST = 2**31 - 1
_MOST_TOOLS = 2**16 - 1
"""Its number stands in 16 bits of a row."""


@compiled
def read_line(line: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Update the state `s`; an input that is not wired is left alone."""
    if line["signal"] >= 0:
        take_sample(line, s, signals[line["signal"]], now_ns)


@compiled.called
def take_sample(line: Record, s: Record, signal: Record, now_ns: int) -> None:
    """Mark a sample as bad that is not finite, flagged by its driver, too old, or missing."""
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
    """Whether the line is 1, by a good sample."""
    return line["signal"] >= 0 and s["bad"] == 0 and s["value"] > 0.5


@compiled
def is_missing(line: Record, s: Record) -> bool:
    """Whether a wired line is not 1: a broken wire counts as 0."""
    return line["signal"] >= 0 and not is_on(line, s)


@compiled
def digital_value(s: Record, most: int) -> int:
    """The signal's whole number, at most `most`; 0 for a bad sample."""
    if s["bad"] != 0:
        return 0
    return int(min(float(most), max(0.0, s["value"])) + 0.5)


@compiled
def begin_part(s: Record, number: int) -> None:
    """A part begins in this cycle."""
    s["part"] = number
    s["parts"] += 1
    s["part_begun"] = s["cycle"]


@compiled
def end_part(s: Record) -> None:
    """The part ends in this cycle."""
    s["part"], s["part_begun"] = 0, -1


@compiled
def follow_tool(p: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Read the number of the tool in this cycle."""
    if p["tool"]["signal"] < 0:
        s["tool"] = 0
        return
    read_line(p["tool"], s["tool_line"], signals, now_ns)
    number = digital_value(s["tool_line"], _MOST_TOOLS + 1)
    s["tool"] = number if number <= _MOST_TOOLS else 0


@compiled
def follow_part(p: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Read the part of this cycle; a part begun by command ends with the tracking."""
    if p["part"]["signal"] < 0:
        if s["part"] != 0 and s["state"] != TRACKING:
            end_part(s)
        return
    read_line(p["part"], s["part_line"], signals, now_ns)
    number = digital_value(s["part_line"], _MOST)
    if number == s["part"]:
        return
    if number == 0:
        end_part(s)
    else:
        begin_part(s, number)


@compiled
def asks_feed_hold(s: Record) -> bool:
    """Whether feed-hold is on: the path is not corrected, or soon will not be."""
    return s["state"] == HOLDING or s["fault"] != NO_FAULT


@compiled
def is_enabled(s: Record) -> bool:
    """Whether the amplifier is asked to be on."""
    state = s["state"]
    return state in (ARMING, TRACKING, HOLDING, RAMPING)


@compiled
def switch(p: Record, s: Record, outputs: Any) -> None:
    """Amplifier on; its reset, for a while after the operator's, at rest only; feed-hold; heartbeat of the loop."""
    resets = s["state"] == READY and s["cycle"] < s["reset_until_cycle"]
    if p["amplifier_enable"] >= 0:
        outputs[p["amplifier_enable"]] = 1.0 if is_enabled(s) else 0.0
    if p["amplifier_reset"] >= 0:
        outputs[p["amplifier_reset"]] = 1.0 if resets else 0.0
    if p["feed_hold"] >= 0:
        outputs[p["feed_hold"]] = 1.0 if asks_feed_hold(s) else 0.0
    if p["heartbeat"] >= 0:
        outputs[p["heartbeat"]] = float(s["cycle"] // p["heartbeat_cycles"] % 2)
