"""A path as it was seen: a file of deviations, or what the tracker saw in a recording, on an even grid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry, open_telemetry
from micromanip.recordings.path_deviation import PathDeviation, read_path_deviation
from micromanip.recordings.reading import is_recording
from micromanip.rt.states import TRACKING

from ...identify.tracker.recorded import samples_taken

_LONGEST_S = 3600.0
_COARSE_HZ = 50.0
"""Rows that come more rarely show nothing of the robot's joints."""
_MOST_TRACKED = 0.9
"""Share of tracked rows from which on the start of a run, where the cell arms, is not worth a word."""


def seen_path(file: Path, axes: Sequence[str]) -> PathDeviation:
    """The deviation of `axes` in `file`, a recording of ours or a table. CheckFailed for what is neither."""
    return recorded_path(open_telemetry(file), axes) if is_recording(file) else read_path_deviation(file, axes)


def recorded_path(telemetry: Telemetry, axes: Sequence[str]) -> PathDeviation:
    """What the tracker saw of each axis, at the times when it saw it; the first axis' times for all."""
    missing = [axis for axis in axes if axis not in telemetry.axes]
    if missing:
        raise CheckFailed(
            f"{telemetry.file}: axis {missing[0]} is not in it; its axes are {', '.join(telemetry.axes) or 'none'}"
        )
    found = []
    for axis in axes:
        _, taken_ns, values = samples_taken(telemetry, axis)
        taken_ns, first = np.unique(taken_ns, return_index=True)
        found.append((taken_ns, values[first]))
    time_ns = found[0][0]
    seen = [np.interp(time_ns, taken, values) for taken, values in found]
    notes = _not_tracked(telemetry)
    return PathDeviation(telemetry.file, tuple(axes), 1e-9 * (time_ns - time_ns[0]), np.column_stack(seen), notes)


def _not_tracked(telemetry: Telemetry) -> tuple[str, ...]:
    """What is to be said of rows in which the cell followed nothing: the robot may have stood, or gone elsewhere."""
    tracked = np.asarray(telemetry.column("state")) == TRACKING
    share = float(np.mean(tracked))
    if share > _MOST_TRACKED:
        return ()
    where = f"did not track in {100 * (1 - share):.0f} % of its rows" if share else "tracked in none of its rows"
    return (f"{telemetry.file}: the cell {where}: what was seen there need not be the path",)


def on_grid(path: PathDeviation, rate_hz: float) -> tuple[Array, list[str]]:
    """Deviation (n, axes) `rate_hz` times a second, by monotone cubics, and what is to be said of the rows."""
    from scipy.interpolate import PchipInterpolator

    seconds = float(path.time_s[-1])
    if seconds > _LONGEST_S:
        raise CheckFailed(f"{path.file}: it lasts {seconds:.6g} s; at most {_LONGEST_S:g} s are previewed: cut it")
    if seconds * rate_hz < 2.0:
        raise CheckFailed(f"{path.file}: it lasts {seconds:.3g} s: too short to say anything")
    steps, notes = np.diff(path.time_s), list(path.notes)
    if np.median(steps) > 1.0 / _COARSE_HZ:
        notes.append(
            f"{path.file}: a row every {np.median(steps):.3g} s: what is faster than {0.5 / np.median(steps):.3g} Hz, "
            "the joints' oscillation too, is not in it"
        )
    gaps = np.flatnonzero(steps > 10.0 * np.median(steps))
    if len(gaps):
        k = int(gaps[0])
        notes.append(
            f"{path.file}: {len(gaps)} gaps, the first of {steps[k]:.3g} s at {path.time_s[k]:.6g} s: bridged smoothly"
        )
    wanted = np.arange(int(seconds * rate_hz) + 1) / rate_hz
    return np.asarray(PchipInterpolator(path.time_s, path.deviation_um)(wanted)), notes
