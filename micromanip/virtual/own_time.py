"""Rows of an experiment as they were on the machine: late samples and late outputs moved to their own time.

A bus delivers a sample rarely and late, and takes a voltage rarely and late. What is fitted to such rows would take the
ways for dynamics of the actuator, and for hysteresis. So each sensor's column becomes a line through its samples, each
at the time at which it was taken, and the voltage moves on by the output's way.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.places import Wiring
from micromanip.settings.wiring.timing import AT_ONCE, feedback_path

_FRESH = {"strain": 1, "stage": 2}


def at_own_time(rows: NDArray[Any], configuration: Configuration, wiring: Wiring) -> NDArray[Any]:
    """The same rows where every sample was of its own cycle; else a copy with the columns moved."""
    paths = [feedback_path(configuration, wiring, axis) for axis in configuration.axes]
    if all(path == AT_ONCE for path in paths) or not len(rows):
        return rows
    moved = rows.copy()
    time_ns, period_ns = rows["time_ns"], configuration.loop.period_ns
    for i, path in enumerate(paths):
        axis, out = rows["axis"][:, i], moved["axis"][:, i]
        for sensor, bit in _FRESH.items():
            fresh = (axis["fresh"] & bit) != 0
            if not fresh.any():
                continue
            taken_ns = (time_ns - axis[f"{sensor}_age_ns"])[fresh]
            out[f"{sensor}_um"] = np.interp(time_ns, taken_ns, axis[f"{sensor}_um"][fresh])
        late_ns = path.output_late * period_ns
        out["voltage_V"] = np.interp(time_ns - late_ns, time_ns, axis["voltage_V"])
    return moved
