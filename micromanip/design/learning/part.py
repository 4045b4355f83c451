"""One part out of a run: path, error and what was played, on an even grid, without lag.

The error is the path, as the tracker's samples show it at the times when they were taken, less the measured stage.
Noise of the tracker that the loop has followed is in both, and so hardly in the error. What was played is what the loop
recorded of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from micromanip.errors import CheckFailed
from micromanip.rt.telemetry import DEVIATION_FRESH

from .spectrum import filtered, low_pass

Array = NDArray[np.float64]

GRID_HZ = 1000.0
"""A memory has about so many values a second."""
_PASSED = 0.25
"""Of the grid's rate, where the low pass before it has its corner."""
_MOST_MISSED, _MOST_LIMITED = 0.05, 0.001
SETTLED_S, BEYOND_S = 0.5, 0.1
"""So long the loop tracks before a part that is learned from, and has settled; and after it: the tracker is late, and
the low pass sees beyond both ends."""


@dataclass(frozen=True)
class Part:
    """One axis during one part, `rate_hz` values (n,) a second, um."""

    rate_hz: float
    path_um: Array
    error_um: Array
    played_um: Array


def part_of(
    rows: NDArray[Any], axis: int, begun: int, seconds: float, period_s: float, range_V: tuple[float, float]
) -> Part:
    """The part of `seconds` that began in cycle `begun`, of the axis with that number.

    `rows` (n,) have the columns of telemetry; the cell tracks in all of them, to `BEYOND_S` after the part. CheckFailed
    where nothing can be learned from it.
    """
    own, cycles = rows["axis"][:, axis], rows["cycle"].astype(np.int64)
    if begun - cycles[0] < round(SETTLED_S / period_s):
        raise CheckFailed(f"it began less than {SETTLED_S:g} s after tracking had")
    time_s = (rows["time_ns"] - rows["time_ns"][0]) * 1e-9
    begin_s = float(begun - cycles[0]) * period_s
    within = (cycles >= begun) & (cycles < begun + round(seconds / period_s))
    _require_good(own["voltage_V"][within], range_V, 1.0 - np.count_nonzero(within) / round(seconds / period_s))
    fresh = (own["fresh"].astype(int) & DEVIATION_FRESH) != 0
    # one sample may come twice over a bus
    taken_s, first = np.unique((time_s - own["deviation_age_ns"] * 1e-9)[fresh], return_index=True)
    if len(taken_s) < 2:
        raise CheckFailed("no samples of the tracker came")
    path = CubicSpline(taken_s, own["deviation_um"][fresh][first])
    step = max(1, round(1.0 / (GRID_HZ * period_s)))
    rate_hz = 1.0 / (step * period_s)
    count, beyond = round(seconds * rate_hz), round(BEYOND_S * rate_hz)
    grid = begin_s + np.arange(-beyond * step, (count + beyond) * step) * period_s

    def thinned(x: Array) -> Array:
        passed = filtered(x, 1.0 / period_s, partial(low_pass, corner_hz=_PASSED * rate_hz))
        return passed[::step][beyond : beyond + count]

    # differences first: both sides of them move far while cycles are missed, and they hardly
    error, played = (
        thinned(np.interp(grid, time_s, each)) for each in (path(time_s) - own["stage_um"], own["learned_um"])
    )
    return Part(rate_hz, thinned(path(grid)), error, played)


def _require_good(voltage: Array, range_V: tuple[float, float], missed: float) -> None:
    if missed > _MOST_MISSED:
        raise CheckFailed(f"{100 * missed:.1f} % of its cycles were missed, at most {100 * _MOST_MISSED:g} % may be")
    limited = float(np.mean((voltage <= range_V[0]) | (voltage >= range_V[1])))
    if limited > _MOST_LIMITED:
        raise CheckFailed(
            f"the voltage was at an end of its range for {100 * limited:.2g} % of it; `micromanip analyse path` says "
            "where the path asks for more than there is"
        )
