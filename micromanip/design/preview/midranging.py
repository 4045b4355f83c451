"""Mid-ranging: the slow part of a deviation handed to the robot as an offset, so that the stage stays in its middle.

The path is known beforehand, so the low-pass needs no delay: a Butterworth filter of second order, forwards and
backwards, of amplitude 1/2 at its corner. What is left to the stage is the path minus the offset as the robot runs
it: straight lines between the rows of its file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import UsageError, system_error

Array = NDArray[np.float64]

_ROWS = 40
"""Rows in a period of the corner."""


@dataclass(frozen=True)
class Offset:
    """Offset (k, axes) in um that the robot adds to its path as commanded, at `time_s` (k,); straight in between."""

    corner_Hz: float
    axes: tuple[str, ...]
    time_s: Array
    offset_um: Array

    def at(self, time_s: Array) -> Array:
        """The offset (n, axes) at `time_s` (n,)."""
        return np.column_stack([np.interp(time_s, self.time_s, column) for column in self.offset_um.T])

    @property
    def speed_um_per_s(self) -> float:
        """The fastest that it moves along one axis."""
        return float(np.abs(np.diff(self.offset_um, axis=0) / np.diff(self.time_s)[:, None]).max())

    def write(self, file: Path) -> None:
        """As CSV, into a file that is not there yet: t_s, and offset_<axis>_um of each axis."""
        lines = [",".join(["t_s", *(f"offset_{axis}_um" for axis in self.axes)])]
        lines += [
            ",".join([f"{t:.9g}", *(f"{um:.3f}" for um in row)])
            for t, row in zip(self.time_s, self.offset_um, strict=True)
        ]
        try:
            with file.open("x", encoding="utf-8") as written:
                written.write("\n".join(lines) + "\n")
        except FileExistsError:
            raise UsageError(f"--offset {file} is there already: nothing is replaced; name another file") from None
        except OSError as problem:
            raise system_error(problem, f"--offset {file}") from problem


def slow_part(axes: Sequence[str], deviation_um: Array, rate_hz: float, corner_hz: float) -> Offset:
    """The offset of a deviation (n, axes) below `corner_hz`."""
    from scipy.signal import butter, sosfiltfilt

    time_s = np.arange(len(deviation_um)) / rate_hz
    every = max(1, int(rate_hz / (_ROWS * corner_hz)))
    sections = butter(2, corner_hz, fs=rate_hz, output="sos")
    around = min(len(deviation_um) - 1, round(3.0 * rate_hz / corner_hz))
    slow = sosfiltfilt(sections, deviation_um, axis=0, padlen=around)
    rows = np.unique(np.append(np.arange(0, len(slow), every), len(slow) - 1))
    return Offset(corner_hz, tuple(axes), time_s[rows], np.asarray(slow)[rows])
