"""The tracker's samples of one axis out of a recording: its longest evenly spaced stretch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.telemetry import DEVIATION_FRESH

# Apart from the fit: the help of a command tells it, and does not wait for what computes.

MOVES_PERCENT = 2.0
"""Narrower filters leave less of a frequency that stays, wider ones of one that jumps or sweeps."""


_EVEN = 0.25
"""How far the time between two samples may be from the usual one, in terms of it: more is a gap."""


def recorded_samples(telemetry: Telemetry, axis: str) -> tuple[NDArray[np.float64], float]:
    """Samples (n,), um, of `axis` and their rate (Hz). Raises CheckFailed where no tracker's samples are in it."""
    place = telemetry.axes.index(axis)
    names = (f"axis.{place}.fresh", f"axis.{place}.deviation_age_ns", "time_ns", f"axis.{place}.deviation_um")
    word, age_ns, time_ns, deviation_um = telemetry.columns(*names).values()
    fresh = (word.astype(int) & DEVIATION_FRESH) != 0
    if np.count_nonzero(fresh) < 2:
        raise CheckFailed(f"{telemetry.file}: axis {axis}: no samples of deviation_{axis} came in it")
    taken_ns = time_ns[fresh].astype(np.int64) - age_ns[fresh].astype(np.int64)
    samples = np.asarray(deviation_um[fresh], dtype=float)
    between = np.diff(taken_ns)
    usual = float(np.median(between))
    gaps = np.flatnonzero(np.abs(between - usual) > _EVEN * usual) + 1
    stretches = np.split(np.arange(len(samples)), gaps)
    longest = max(stretches, key=len)
    return samples[longest], 1e9 / usual
