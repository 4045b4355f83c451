"""Which part is being made, and with which tool: what the machine says, or a command.

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
from .states import TRACKING

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
