"""Digital signals of the machine: amplifier, feed-hold, heartbeat; which part it makes, and with which tool.

The signal ``part`` is 0 while none is, and any other number while one is: a line that is 1 meanwhile, or a counter. A
part begins in the cycle in which the number changes, and ends with it; a signal that is not usable counts as 0. Without
that signal a part begins and ends by command, and ends where the cell does not track any more.

The signal ``tool`` is the number of the tool in the spindle, 0 for none. One that is not usable, or no such number,
counts as 0. Without it the tool is 0.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.laws.digital_input import digital_value, read_line

from .jit import compiled
from .record import Record
from .states import ARMING, HOLDING, NO_FAULT, RAMPING, READY, TRACKING

_MOST = 2**31 - 1
_MOST_TOOLS = 2**16 - 1
"""Its number stands in 16 bits of a row."""


@compiled
def begin_part(s: Record, number: int) -> None:
    """A part begins in this cycle."""
    s["part"] = number
    s["parts"] += 1
    s["part_begun"] = s["cycle"]


@compiled
def end_part(s: Record) -> None:
    """None is being made any more."""
    s["part"], s["part_begun"] = 0, -1


@compiled
def follow_tool(p: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Take the machine's word for the tool of this cycle."""
    if p["tool"]["signal"] < 0:
        s["tool"] = 0
        return
    read_line(p["tool"], s["tool_line"], signals, now_ns)
    number = digital_value(s["tool_line"], _MOST_TOOLS + 1)
    s["tool"] = number if number <= _MOST_TOOLS else 0


@compiled
def follow_part(p: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Take the machine's word for the part of this cycle; what a command has begun ends with the tracking."""
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
    """Whether the machine is asked to stop feeding: the path is not corrected, or not for long."""
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
