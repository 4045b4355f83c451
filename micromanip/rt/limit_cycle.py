"""Limit cycles: what goes from one end of its range to the other again and again, whatever the limits."""

from __future__ import annotations

from typing import Any

from .jit import compiled
from .record import Record, record
from .states import VOLTAGE

SWING = record(("end", "i8"), ("times", "i8"), ("first_cycle", "i8"))
"""What went from one end of its range to the other: where it was last (-1, 1; 0: none yet), how often, since when."""


@compiled
def sensor_end(sensor: Record, range_um: Any) -> int:
    """1 or -1 where a sensor reads the upper or lower end of its range, or more; 0 inside.

    One that says by its status that it is at an end reads the same again and again, away from its last good value.
    """
    reading = sensor["reading"]
    if reading >= range_um[1]:
        return 1
    if reading <= range_um[0]:
        return -1
    if sensor["bad"] < 2 or sensor["identical"] == 0 or reading == sensor["value"]:
        return 0
    return 1 if reading > sensor["value"] else -1


@compiled
def swings(limits: Record, w: Record, cycle: int, end: int) -> bool:
    """Whether something that is at `end` of its range (0: inside) went from one to the other again and again."""
    if end != 0 and end != w["end"]:
        if w["end"] != 0:
            if w["times"] == 0 or cycle - w["first_cycle"] > limits["swing_cycles"]:
                w["times"], w["first_cycle"] = 0, cycle
            w["times"] += 1
        w["end"] = end
    return w["times"] >= limits["swings"]


@compiled
def watch_swing(axis: Record, a: Record, w: Record, cycle: int, active: bool) -> bool:
    """Limit cycle: voltage or set-point, the gauge or the stage goes from end to end. No configuration allows that.

    In open loop the voltage is what was asked for; what it does to the sensors counts there too. Nor does any allow
    fast gains that outrun the set-point whenever they are back (``supervisor.py``).
    """
    limits, limiter = axis["watch"], axis["limiter"]
    if not active:
        w["driven_swing"]["end"] = w["strain_swing"]["end"] = w["stage_swing"]["end"] = 0
        w["driven_swing"]["times"] = w["strain_swing"]["times"] = w["stage_swing"]["times"] = 0
        return False
    up = a["voltage_V"] >= limiter["high_V"] or a["setpoint_um"] >= axis["setpoint_high_um"]
    down = a["voltage_V"] <= limiter["low_V"] or a["setpoint_um"] <= axis["setpoint_low_um"]
    found = axis["mode"] != VOLTAGE and swings(limits, w["driven_swing"], cycle, int(up) - int(down))
    if axis["strain"] >= 0:
        found |= swings(limits, w["strain_swing"], cycle, sensor_end(a["strain"], axis["strain_range_um"]))
    if axis["stage"] >= 0:
        found |= swings(limits, w["stage_swing"], cycle, sensor_end(a["stage"], axis["stage_range_um"]))
    return found or a["supervisor"]["relapses"] >= limits["swings"]


@compiled
def swings_for(axis: Record, a: Record, w: Record, cycle: int) -> int:
    """Cycles for which there has been a limit cycle, by the last of those that have been found."""
    most, since = axis["watch"]["swings"], cycle
    if axis["mode"] != VOLTAGE and w["driven_swing"]["times"] >= most:
        since = w["driven_swing"]["first_cycle"]
    if axis["strain"] >= 0 and w["strain_swing"]["times"] >= most:
        since = w["strain_swing"]["first_cycle"]
    if axis["stage"] >= 0 and w["stage_swing"]["times"] >= most:
        since = w["stage_swing"]["first_cycle"]
    return cycle - (a["supervisor"]["relapsed_cycle"] if a["supervisor"]["relapses"] >= most else since)
