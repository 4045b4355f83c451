"""A robot's deviation out of a file, as the simulated cell plays it: even rows, a cubic between them.

Between rows k and k + 1 runs the cubic of Catmull and Rom: its slope at a row is that between the neighbours, so speed
has no steps. Before the first row and behind the last one the robot stands still where they are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from micromanip.driver import CheckFailed, ConfigError

from .options import Deviation
from .records import MOST_ROWS, compiled


def fill_path(path: Any, options: Deviation, axes: tuple[str, ...]) -> None:
    """Fill a PATH record from the file of `options`; without one ``rows`` stays 0. Raises ConfigError."""
    if options.file is None:
        return
    from micromanip.driver import read_path_deviation  # readers that nobody else needs

    try:
        found = read_path_deviation(Path(options.file), axes)
        rows_per_s = 1.0 / found.even_step_s()
    except CheckFailed as problem:
        raise ConfigError(f"deviation.file: {problem}") from problem
    rows = len(found.time_s)
    if rows > MOST_ROWS:
        raise ConfigError(f"deviation.file: {options.file}: {rows} rows; at most {MOST_ROWS} are played: thin them")
    path["rows"], path["rows_per_s"], path["start_s"] = rows, rows_per_s, options.start_s
    path["um"][: len(axes), :rows] = found.deviation_um.T


@compiled
def played(path: Any, axis: int, t_s: float) -> float:
    """Deviation (um) of `axis` at `t_s` since the loop's start."""
    last = path["rows"] - 1
    place = (t_s - path["start_s"]) * path["rows_per_s"]
    if place <= 0.0:
        return path["um"][axis, 0]
    if place >= last:
        return path["um"][axis, last]
    k = int(place)
    f = place - k
    here, there = path["um"][axis, k], path["um"][axis, k + 1]
    slope = 0.5 * (there - path["um"][axis, max(0, k - 1)])
    next_slope = 0.5 * (path["um"][axis, min(last, k + 2)] - here)
    step = there - here
    return here + f * (slope + f * (3.0 * step - 2.0 * slope - next_slope + f * (slope + next_slope - 2.0 * step)))
