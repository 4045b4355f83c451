"""From a file of a robot's deviation to the record that the simulated cell plays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from micromanip.driver import CheckFailed, ConfigError

from .options import Deviation
from .records import MOST_ROWS


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
