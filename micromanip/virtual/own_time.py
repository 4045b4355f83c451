"""Rows of an experiment as they were on the machine: late samples and late outputs moved to their own time.

A bus delivers a sample rarely and late, and takes a voltage rarely and late; a wire that is waited for delivers some
late; and while the loop misses cycles, plant and sensors go on. What is fitted to such rows would take the ways for
dynamics of the actuator, and for hysteresis, and samples that stand still for noise. So each sensor's column becomes a
line through its samples, each at the time at which it was taken, and the voltage moves on by the output's way.
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
    """The same rows where every sample was of its own cycle; else a copy with the columns moved.

    Of a cycle that was missed there is the row of the one before once more.
    """
    paths = [feedback_path(configuration, wiring, axis) for axis in configuration.axes]
    if not len(rows):
        return rows
    missed = _missed(rows["cycle"])
    at_once = all(path == AT_ONCE for path in paths) and not missed.any()
    if at_once and not _has_late(rows["axis"][:, : len(paths)]):
        return rows
    moved, period_ns = rows.copy(), configuration.loop.period_ns
    time_ns = rows["time_ns"] + missed * period_ns
    for i, path in enumerate(paths):
        axis, out = rows["axis"][:, i], moved["axis"][:, i]
        for sensor, bit in _FRESH.items():
            fresh = ((axis["fresh"] & bit) != 0) & (missed == 0)
            if not fresh.any():
                continue
            taken_ns = (time_ns - axis[f"{sensor}_age_ns"])[fresh]
            out[f"{sensor}_um"] = np.interp(time_ns, taken_ns, axis[f"{sensor}_um"][fresh])
        late_ns = path.output_late * period_ns
        out["voltage_V"] = np.interp(time_ns - late_ns, time_ns, axis["voltage_V"])
    return moved


def _has_late(axes: NDArray[Any]) -> bool:
    """Whether any sensor that there is (rows, axes) has a sample that is not of its row."""
    for sensor, bit in _FRESH.items():
        fresh = (axes["fresh"] & bit) != 0
        late = ~fresh | (axes[f"{sensor}_age_ns"] > 0)
        if late[:, fresh.any(axis=0)].any():
            return True
    return False


def _missed(cycle: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each row how many cycles after that of its number it stands."""
    place = np.arange(len(cycle))
    first = np.diff(cycle, prepend=cycle[0] - 1) != 0
    return place - np.maximum.accumulate(np.where(first, place, 0))
