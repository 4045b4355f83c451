"""One sub-step and one set of readings of one simulated axis."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .played_path import played
from .preisach import bouc_wen_step, preisach_step
from .records import CHANNELS, CREEP_OPERATORS, DEVIATION_SINES, HARMONICS, MECHANICAL_STATES, SUBSTEPS, compiled
from .samples import normal, put


@compiled
def drive(p: Any, s: Any, powered: bool) -> float:
    """Amplifier and stack over one sub-step: free displacement (um) for the latched voltage.

    Without power the amplifier's bleed resistor discharges the stack.
    """
    if powered:
        change = (s["latched_V"] - s["amplifier_V"]) * p["amplifier_step"]
        s["amplifier_V"] += max(-p["slew_V"], min(p["slew_V"], change))
    else:
        s["amplifier_V"] -= p["bleed_step"] * s["amplifier_V"]
    volts = s["amplifier_V"] + p["amplifier_noise_V"] * normal(s)
    if p["bouc_wen"]["present"] != 0:
        pure = bouc_wen_step(p["bouc_wen"], s["bouc_wen"], volts)
    else:
        pure = preisach_step(p["preisach"], s["memory"], volts)
    free = pure * (1.0 - CREEP_OPERATORS * p["creep_gain"])
    for i in range(CREEP_OPERATORS):
        s["creep_um"][i] += p["creep_step"][i] * (p["creep_gain"] * pure - s["creep_um"][i])
        free += s["creep_um"][i]
    return free


@compiled
def move(p: Any, x: Any, free_um: float, force_N: float) -> None:
    """Mechanics over one sub-step."""
    y0, y1, y2, y3, y4, y5, y6 = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
    for i in range(MECHANICAL_STATES):
        x[i] = (
            p["a"][i, 0] * y0
            + p["a"][i, 1] * y1
            + p["a"][i, 2] * y2
            + p["a"][i, 3] * y3
            + p["a"][i, 4] * y4
            + p["a"][i, 5] * y5
            + p["a"][i, 6] * y6
            + p["b"][i, 0] * free_um
            + p["b"][i, 1] * force_N
        )


@compiled
def push(c: Any) -> None:
    """Force (N) of the flexure on each stage in the sub-step to come, by how far the others are from where they rested.

    A force is held over a sub-step: that of its middle, where the others are by then at their present speed.
    """
    middle_s = 0.5e-9 * c["period_ns"] / SUBSTEPS
    for i in range(c["axes"]):
        force_N = 0.0
        for j in range(c["axes"]):
            x = c["s"][j]["x"]
            force_N += c["p"][i]["pushed_N_per_um"][j] * (x[2] + middle_s * x[3] - c["s"][j]["rested_um"])
        c["s"][i]["pushed_N"] = force_N


@compiled
def machining_force(p: Any, s: Any, t_s: float) -> float:
    """Force (N) on the stage at `t_s` of the work, once a period: steady, tooth passing, coloured noise."""
    t = t_s - p["force_start_s"]
    if t < 0.0:
        return 0.0
    s["engaged"] += p["force_step"] * (1.0 - s["engaged"])
    decay = p["force_noise_decay"]
    s["coloured_N"] = decay * s["coloured_N"] + p["force_noise_N"] * math.sqrt(1.0 - decay * decay) * normal(s)
    return p["force_static_N"] * s["engaged"] + p["tooth_N"] * swing(p, t) + s["coloured_N"]


@compiled
def swing(p: Any, t_s: float) -> float:
    """Force of the teeth over ``tooth_N``, `t_s` after the tool has engaged: its sine and harmonics."""
    angle = p["tooth_omega"] * t_s
    total = math.sin(angle)
    for k in range(HARMONICS):
        if p["harmonics"][k] != 0.0:
            total += p["harmonics"][k] * math.sin((k + 2.0) * angle)
    return total


@compiled
def deviation(c: Any, axis: int, t_s: float) -> float:
    """Path deviation (um) of the robot along `axis` at `t_s`."""
    if c["path"]["rows"] > 0:
        return played(c["path"], axis, t_s)
    p, total = c["p"][axis], 0.0
    for i in range(DEVIATION_SINES):
        total += p["deviation_um"][i] * math.sin(p["deviation_omega"][i] * t_s + p["deviation_phase"][i])
    return total


@compiled
def quantised(value: float, step: float, limit: float) -> float:
    """Reading of a converter with the given step and range."""
    return max(-limit, min(limit, step * math.floor(value / step + 0.5)))


_CHANNELS = len(CHANNELS)
SATURATED = 1
"""Status of a capacitive sample at the end of its range: it says no more than that."""
_HUM_PHASE = 1.0


@compiled
def stage_position(c: Any, i: int) -> float:
    """Where the spindle is along axis `i` (um, as the capacitive sensor counts), with cross-coupling and drift."""
    total = c["s"][i]["drift_um"]
    for j in range(c["axes"]):
        p, x = c["p"][j], c["s"][j]["x"]
        rocking = p["rocking"] * (x[5] - p["lever"] * x[0])
        total += c["p"][i]["coupling"][j] * (x[2] + rocking - p["stage_zero_um"])
    return total


@compiled
def read(c: Any, inputs: Any, now_ns: int) -> None:
    """Readings of all sensors, and the truth behind them, channels of one axis side by side."""
    t_s = c["periods"] * c["period_ns"] * 1e-9
    for i in range(c["axes"]):
        p, s, first = c["p"][i], c["s"][i], i * _CHANNELS
        stage = stage_position(c, i)
        path = deviation(c, i, t_s)
        hum = p["hum_um"] * np.sin(p["hum_omega"] * t_s + _HUM_PHASE)
        strain = s["x"][4] - p["strain_zero_um"] + p["strain_noise_um"] * normal(s) + hum
        put(inputs[first], quantised(strain, p["strain_step_um"], p["strain_range_um"]), now_ns)
        seen = stage + p["stage_noise_um"] * normal(s)
        put(inputs[first + 1], max(-p["stage_range_um"], min(p["stage_range_um"], seen)), now_ns)
        if abs(seen) > p["stage_range_um"]:
            inputs[first + 1]["status"] = SATURATED
        due = c["periods"] // p["tracker_periods"]
        if due > s["tracked"]:
            # after an overrun only the newest of those that came meanwhile, taken when it was due
            s["tracked"] = due
            passed_ns = (c["periods"] - due * p["tracker_periods"]) * c["period_ns"]
            taken_s = t_s - (passed_ns + p["tracker_latency_ns"]) * 1e-9
            tracked = p["tracker_noise_um"] * normal(s)
            for j in range(c["axes"]):
                if p["tracker_row"][j] != 0.0:
                    tracked += p["tracker_row"][j] * deviation(c, j, taken_s)
            put(inputs[first + 2], tracked, now_ns - passed_ns - p["tracker_latency_ns"])
        row = p["stage_acceleration"]
        acceleration = row[MECHANICAL_STATES + 1] * (s["force_N"] + s["pushed_N"]) + p["acceleration_noise"] * normal(s)
        for k in range(MECHANICAL_STATES):
            acceleration += row[k] * s["x"][k]
        put(inputs[first + 3], acceleration, now_ns)
        put(inputs[first + 4], s["x"][0] - p["strain_zero_um"], now_ns)
        put(inputs[first + 5], stage, now_ns)
        put(inputs[first + 6], path - stage, now_ns)
        put(inputs[first + 7], path - s["free_x"][2] - s["drift_um"], now_ns)
