"""Whether an axis swings while its reference is held: a line that has most of what its error does.

Noise has no such line. A limit cycle has one, so has a vibration; which of them it is, a person finds out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.states import CLOSED
from micromanip.status_reply import Swing

_WINDOW_NS, _LEAST = 1_000_000_000, 60
"""How much of the past is looked at, and how many samples it must have."""
_BAND_HZ, _MOST, _SHARE = (3.0, 1000.0), 0.6, 0.005
"""Where a swing is looked for; the line's least share of the variance; its least amplitude, as a share of the
set-point's range."""
Array = NDArray[np.float64]


class Swings:
    """The last second of each of `count` axes."""

    def __init__(self, count: int) -> None:
        self._past: Any = np.zeros(0, [("time_ns", "i8"), ("held", "?"), ("axis", "f8", (count, 3))])

    def add(self, rows: Any) -> None:
        """Take in rows of the telemetry ring."""
        if not len(rows):
            return
        oldest_ns = rows["time_ns"][-1] - _WINDOW_NS
        rows = rows[rows["time_ns"] > oldest_ns]
        past = self._past[self._past["time_ns"] > oldest_ns]
        kept = np.zeros(len(rows), past.dtype)
        kept["time_ns"], kept["held"] = rows["time_ns"], rows["phase"] == CLOSED
        for k, name in enumerate(("reference_um", "stage_um", "strain_um")):
            kept["axis"][:, :, k] = rows["axis"][name][:, : kept["axis"].shape[1]]
        self._past = np.concatenate([past, kept])

    def of(self, i: int, of_path: bool, way_um: float) -> Swing | None:
        """The swing of axis `i`, of its path or else of its gauge; None: none, or its reference is not held.

        `way_um` is its set-point's range.
        """
        past = self._past
        reference, stage, strain = past["axis"][:, i].T
        if len(past) < _LEAST or not past["held"].all() or np.ptp(reference) != 0.0:
            return None
        return swing(past["time_ns"], stage if of_path else strain, _SHARE * way_um)


def swing(time_ns: NDArray[np.int64], moved_um: Array, least_um: float) -> Swing | None:
    """The line of at least `least_um` that has most of what `moved_um` (n,) does, or None; repeated values are one."""
    new = np.r_[True, np.diff(moved_um) != 0.0] & np.isfinite(moved_um)
    seconds = 1e-9 * (time_ns[-1] - time_ns[0])
    count = int(np.count_nonzero(new))
    if count < _LEAST or seconds < 0.9e-9 * _WINDOW_NS:
        return None
    even = np.linspace(time_ns[0], time_ns[-1], count)
    y = np.interp(even, time_ns[new], moved_um[new])
    trend = np.polyval(np.polyfit(even - even[0], y, 1), even - even[0])
    power = np.abs(np.fft.rfft((y - trend) * np.hanning(count))) ** 2
    hertz = np.arange(len(power)) / seconds
    power[(hertz < _BAND_HZ[0]) | (hertz > _BAND_HZ[1])] = 0.0
    k = int(np.argmax(power))
    share = power[max(0, k - 2) : k + 3].sum() / max(power.sum(), 1e-300)
    amplitude_um = float(np.sqrt(2.0 * share) * (y - trend).std())
    if hertz[k - 1] < _BAND_HZ[0] or share < _MOST or amplitude_um < least_um:  # at the lowest it is a drift
        return None
    return {"Hz": round(float(hertz[k]), 1), "um": round(amplitude_um, 3)}
