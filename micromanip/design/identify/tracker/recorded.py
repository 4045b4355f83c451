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


def samples_taken(telemetry: Telemetry, axis: str) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.float64]]:
    """Rows (k,) in which a sample of the tracker came, when it was taken (k,), ns, and what it said (k,), um.

    Raises CheckFailed where not two are in the recording.
    """
    place = f"axis.{telemetry.axes.index(axis)}"
    names = ("time_ns", f"{place}.fresh", f"{place}.deviation_age_ns", f"{place}.deviation_um")
    time_ns, word, age_ns, deviation_um = telemetry.columns(*names).values()
    came = np.flatnonzero((word.astype(int) & DEVIATION_FRESH != 0) & np.isfinite(deviation_um) & np.isfinite(age_ns))
    if len(came) < 2:
        raise CheckFailed(f"{telemetry.file}: axis {axis}: no samples of deviation_{axis} came in it")
    taken_ns = time_ns[came].astype(np.int64) - age_ns[came].astype(np.int64)
    return came, taken_ns, np.asarray(deviation_um[came], dtype=float)


def recorded_samples(telemetry: Telemetry, axis: str) -> tuple[NDArray[np.float64], float]:
    """Samples (n,), um, of `axis` and their rate (Hz). Raises CheckFailed where no tracker's samples are in it."""
    _, taken_ns, samples = samples_taken(telemetry, axis)
    between = np.diff(taken_ns)
    usual = float(np.median(between))
    gaps = np.flatnonzero(np.abs(between - usual) > _EVEN * usual) + 1
    return max(np.split(samples, gaps), key=len), 1e9 / usual
