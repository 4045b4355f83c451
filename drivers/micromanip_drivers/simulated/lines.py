"""The cell's digital lines: what amplifier and PLC do on a switch, and what they report.

    enable, interlock, amplifier_ok, temperature_ok    1 unless a scheduled fault says otherwise
    amplifier_enable 0, or enable 0                    the amplifier discharges the stack
    feed_hold 1                                        the tool leaves the cut; retracted 1 when it is out
    heartbeat                                          must change, or the amplifier switches itself off

The amplifier's watchdog watches while the amplifier is enabled. Once it has tripped, the amplifier stays off and
not ok until amplifier_enable has been taken away.
"""

from __future__ import annotations

from typing import Any

from .records import CELL_LINES, compiled
from .samples import put

_CELL_LINES = len(CELL_LINES)


@compiled
def powered(line: Any) -> bool:
    """Whether the amplifier drives its output; without lines it always does."""
    if line["present"] == 0:
        return True
    return line["amplifier_enable"] == 1 and line["enable"] != 0.0 and line["tripped"] == 0


@compiled
def worked_periods(line: Any, passed: int) -> int:
    """Periods since work began, the first of `passed`; with lines, since the amplifier was first switched on.

    Nobody machines with a manipulator that is off.
    """
    return passed if line["present"] == 0 else int(line["worked_periods"])


@compiled
def cut_share(line: Any) -> float:
    """Share of the machining force that is left while the tool retracts: 1 in the cut, 0 when it is out."""
    if line["feed_hold"] == 0:
        return 1.0
    return 1.0 - min(1.0, line["held_periods"] / line["retract_periods"])


@compiled
def advance_lines(line: Any) -> None:
    """One loop period passes: the tool retracts, the watchdog's time runs."""
    if line["present"] == 0:
        return
    if line["amplifier_enable"] == 1 or line["worked_periods"] > 0:
        line["worked_periods"] += 1
    if line["feed_hold"] != 0:
        line["held_periods"] += 1
    line["silent_periods"] += 1
    watches = line["heartbeat_periods"] > 0 and line["amplifier_enable"] == 1
    if watches and line["silent_periods"] > line["heartbeat_periods"]:
        line["tripped"] = 1


@compiled
def read_lines(c: Any, inputs: Any, now_ns: int) -> None:
    """Leave a fresh sample of every line: the cell's, then each kind for all axes."""
    line = c["lines"]
    if line["present"] == 0:
        return
    first = line["first_input"]
    put(inputs[first], 1.0, now_ns)
    put(inputs[first + 1], 1.0, now_ns)
    retracted = line["feed_hold"] != 0 and line["held_periods"] >= line["retract_periods"]
    put(inputs[first + 2], 1.0 if retracted else 0.0, now_ns)
    for i in range(c["axes"]):
        amplifier = first + _CELL_LINES + i
        put(inputs[amplifier], 0.0 if line["tripped"] != 0 else 1.0, now_ns)
        put(inputs[amplifier + c["axes"]], 1.0, now_ns)


@compiled
def latch_switches(line: Any, outputs: Any) -> None:
    """Take the switches decided in the cycle before."""
    if line["present"] == 0:
        return
    first = line["first_output"]
    line["amplifier_enable"] = 1 if outputs[first] == 1.0 else 0
    line["feed_hold"] = 1 if outputs[first + 1] == 1.0 else 0
    if line["feed_hold"] == 0:
        line["held_periods"] = 0
    if outputs[first + 2] != line["heartbeat"]:
        line["heartbeat"] = outputs[first + 2]
        line["silent_periods"] = 0
    if line["amplifier_enable"] == 0:
        line["silent_periods"] = 0
        line["tripped"] = 0


@compiled
def follow_enable(line: Any, inputs: Any) -> None:
    """The enable circuit acts on the amplifier itself; `inputs` show it as a scheduled fault left it."""
    if line["present"] != 0 and inputs[line["first_input"]]["sequence"] > 0:
        line["enable"] = inputs[line["first_input"]]["value"]


@compiled
def make_safe(c: Any) -> int:
    """Every voltage to 0 and the amplifier off, noted for whoever looks; with the loop dead nothing rings."""
    for i in range(c["axes"]):
        c["s"][i]["latched_V"] = 0.0
    c["lines"]["amplifier_enable"] = 0
    c["safe"] = 1
    return 0
