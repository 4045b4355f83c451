"""What swings: the inner loop in a band of its error; anything from end to end, whatever the limits.

The energy of the error in the band where the inner loop would swing: without the tooth's frequency, whose cancelling
asks much of the loop, and only what is more than the set-point's own there, since an error in following is no swing. A
loop that swings has the larger error, also where the outer loop answers it. The filters are second-order sections. They
take the gauge's samples, not the cycles between: a held one would look like a swing.
"""

from __future__ import annotations

import math
from typing import Any

from .jit import compiled
from .record import Record, record
from .states import VOLTAGE

SECTION = record(("b", "f8", (3,)), ("a", "f8", (2,)))
"""y[n] = b0 x[n] + b1 x[n-1] + b2 x[n-2] - a0 y[n-1] - a1 y[n-2]."""
SECTION_STATE = record(("x1", "f8"), ("x2", "f8"), ("y1", "f8"), ("y2", "f8"))
"""The last two inputs and outputs."""
SWING = record(("end", "i8"), ("times", "i8"), ("first_cycle", "i8"))
"""What went from one end of its range to the other: where it was last (-1, 1; 0: none yet), how often, since when."""
DRIVEN, GAUGE, SENSOR = range(3)
"""What may: voltage and set-point, the gauge, the capacitive sensor."""


@compiled
def start_section(p: Record, s: Record, x: float) -> float:
    """Start as after a long rest at `x`; returns the output there."""
    b, a = p["b"], p["a"]
    s["x1"] = s["x2"] = x
    s["y1"] = s["y2"] = y = x * (b[0] + b[1] + b[2]) / (1.0 + a[0] + a[1])
    return y


@compiled
def section_output(p: Record, s: Record, x: float) -> float:
    """One step: the output for the input `x`."""
    b, a = p["b"], p["a"]
    y = b[0] * x + b[1] * s["x1"] + b[2] * s["x2"] - a[0] * s["y1"] - a[1] * s["y2"]
    s["x2"], s["x1"] = s["x1"], x
    s["y2"], s["y1"] = s["y1"], y
    return y


@compiled
def swing_um(w: Record) -> float:
    """The rms (um) of what swings in the band."""
    return math.sqrt(max(0.0, w["band_energy"]))


@compiled
def watch_oscillation(limits: Record, a: Record, w: Record, active: bool) -> None:
    """Carry ``band_energy`` (um^2) on by a fresh sample; while not `active` it is 0, and the filters are at rest."""
    band_pass, notch = limits["band_pass"], limits["tooth_notch"]
    if not active:
        start_section(notch, w["error_notch"], start_section(band_pass, w["error_band"], 0.0))
        start_section(notch, w["asked_notch"], start_section(band_pass, w["asked_band"], a["setpoint_um"]))
        w["band_energy"] = 0.0
    elif a["error_fresh"]:
        error_um = section_output(
            notch, w["error_notch"], section_output(band_pass, w["error_band"], a["strain_error_um"])
        )
        asked_um = section_output(notch, w["asked_notch"], section_output(band_pass, w["asked_band"], a["setpoint_um"]))
        w["band_energy"] += limits["band_step"] * (error_um * error_um - asked_um * asked_um - w["band_energy"])


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
def count_swing(limits: Record, w: Record, cycle: int, end: int) -> bool:
    """Whether something that is at `end` of its range (0: inside) went from one to the other again and again."""
    if end != 0 and end != w["end"]:
        if w["end"] != 0:
            if w["times"] == 0 or cycle - w["first_cycle"] > limits["swing_cycles"]:
                w["times"], w["first_cycle"] = 0, cycle
            w["times"] += 1
        w["end"] = end
    return w["times"] >= limits["swings"]


@compiled
def watch_swings(axis: Record, a: Record, w: Record, cycle: int, active: bool) -> bool:
    """Limit cycle: voltage or set-point, the gauge or the stage goes from end to end. No configuration allows that.

    In open loop the voltage is what was asked for; what it does to the sensors counts there too. Nor does any allow
    fast gains that outrun the set-point whenever they are back (``supervisor.py``).
    """
    limits, limiter, swing = axis["watch"], axis["limiter"], w["swing"]
    if not active:
        for k in range(3):
            swing[k]["end"] = swing[k]["times"] = 0
        return False
    up = a["voltage_V"] >= limiter["high_V"] or a["setpoint_um"] >= axis["setpoint_high_um"]
    down = a["voltage_V"] <= limiter["low_V"] or a["setpoint_um"] <= axis["setpoint_low_um"]
    found = axis["mode"] != VOLTAGE and count_swing(limits, swing[DRIVEN], cycle, int(up) - int(down))
    if axis["strain"] >= 0:
        found |= count_swing(limits, swing[GAUGE], cycle, sensor_end(a["strain"], axis["strain_range_um"]))
    if axis["stage"] >= 0:
        found |= count_swing(limits, swing[SENSOR], cycle, sensor_end(a["stage"], axis["stage_range_um"]))
    return found or a["supervisor"]["relapses"] >= limits["swings"]


@compiled
def swings_for(axis: Record, a: Record, w: Record, cycle: int) -> int:
    """Cycles for which there has been a limit cycle, by the last of those that have been found."""
    most, since = axis["watch"]["swings"], cycle
    for k in range(3):
        if w["swing"][k]["times"] >= most:
            since = w["swing"][k]["first_cycle"]
    return cycle - (a["supervisor"]["relapsed_cycle"] if a["supervisor"]["relapses"] >= most else since)
