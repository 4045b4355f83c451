"""What the sensors read, and the truth behind them."""

from __future__ import annotations

from typing import Any

import numpy as np

from .plant import deviation, quantised
from .records import CHANNELS, MECHANICAL_STATES, compiled
from .samples import normal, put

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
