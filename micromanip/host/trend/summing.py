"""Rows of the telemetry to lines of a trend: what each second and each minute of UTC amounts to.

A second begins with its first row, at the time that the system's clock shows then, and ends with the second of that
clock. A clock that is set while it runs makes one longer or shorter, once, and the next rows have the new time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from micromanip.host.axis_values import QUANTITIES
from micromanip.host.windows import Array
from micromanip.recordings.table import table_line
from micromanip.recordings.trend import COUNTED, FAULT, MINUTE, SECOND, STATE, STATISTICS, TIME
from micromanip.rt.telemetry import LINK_DOWN, TEMPERATURE_OK

_TIMES = ("lateness", "compute")
_NS = 1_000_000_000

Put = Callable[[str, str, str], None]
"""Takes the kind of a line, its day and the line."""


def unix_offset_ns() -> int:
    """What the system's clock is ahead of the loop's, CLOCK_MONOTONIC."""
    return time.time_ns() - time.monotonic_ns()


def header(axes: Sequence[str], watched: Sequence[bool]) -> str:
    """Names of the columns; `watched` says of each axis whether it has a contact of its temperature."""
    measured = [f"{name}_us" for name in _TIMES] + [f"{name}_{axis}" for axis in axes for name in QUANTITIES]
    good = [f"temperature_ok_{axis}" for axis, is_watched in zip(axes, watched, strict=True) if is_watched]
    return ",".join([TIME, *COUNTED, STATE, FAULT, *good, *(f"{m}_{each}" for m in measured for each in STATISTICS)])


class Summary:
    """Figures of any number of rows; two of them make one."""

    def __init__(self, columns: int, axes: int) -> None:
        self._counted = np.zeros(len(COUNTED))
        self._state = self._fault = 0
        self._good = np.ones(axes, bool)
        self._counts = np.zeros(columns, np.int64)
        self._sums, self._squares = np.zeros((2, columns))
        self._low, self._high = np.full(columns, np.inf), np.full(columns, -np.inf)

    @property
    def is_empty(self) -> bool:
        """Whether no row is in it."""
        return not self._counted.any()

    def add(self, rows: Any, values: Array, period_ns: int) -> None:
        """Take in rows, at least one; `values` (rows, columns) are NaN where one is not known."""
        periods, faults = rows["periods"], rows["fault"][rows["fault"] != 0]
        down = np.count_nonzero(rows["lines"] & LINK_DOWN)
        self._counted += np.array([periods.sum() * period_ns * 1e-9, len(rows), np.count_nonzero(periods > 1), down])
        self._state = int(rows["state"][-1])
        self._fault = int(faults[-1]) if len(faults) else self._fault
        self._good &= ((rows["axis"]["fresh"] & TEMPERATURE_OK) != 0).all(axis=0)[: len(self._good)]
        known = np.isfinite(values)
        finite = np.where(known, values, 0.0)
        self._counts += known.sum(axis=0)
        self._sums += finite.sum(axis=0)
        self._squares += np.square(finite).sum(axis=0)
        self._low = np.minimum(self._low, np.where(known, values, np.inf).min(axis=0))
        self._high = np.maximum(self._high, np.where(known, values, -np.inf).max(axis=0))

    def join(self, later: Summary) -> None:
        """Take in what came after it."""
        self._counted += later._counted
        self._state, self._fault = later._state, later._fault or self._fault
        self._good &= later._good
        self._counts += later._counts
        self._sums += later._sums
        self._squares += later._squares
        self._low, self._high = np.minimum(self._low, later._low), np.maximum(self._high, later._high)

    def cells(self, watched: Sequence[bool]) -> list[str]:
        """As the header says, but for the time."""
        with np.errstate(invalid="ignore"):  # 0/0: not known
            means = self._sums / self._counts
            figures = np.stack([self._low, means, self._high, np.sqrt(self._squares / self._counts)])
        figures[:, self._counts == 0] = np.nan
        seconds, *counts = self._counted
        good = [str(int(each)) for each, is_watched in zip(self._good, watched, strict=True) if is_watched]
        plain = [f"{seconds:.4g}", *(f"{count:.0f}" for count in counts), str(self._state), str(self._fault), *good]
        return plain + [f"{value:.6g}" for value in figures.T.ravel()]


class Summing:
    """Follows the rows of one controller."""

    def __init__(
        self,
        watched: Sequence[bool],
        period_ns: int,
        put: Put,
        offset_ns: Callable[[], int] = unix_offset_ns,
    ) -> None:
        """`watched` as in `header`; lines that are ready are given to `put`."""
        self._watched, self._period_ns, self._put, self._offset_ns = watched, period_ns, put, offset_ns
        self._columns = len(_TIMES) + len(watched) * len(QUANTITIES)
        self._second, self._minute = self._none(), self._none()
        self._began_s = self._minute_s = self._end_ns = 0

    def add(self, rows: Any, quantities: Array) -> None:
        """Take in rows of the telemetry ring, and their `QUANTITIES` (rows, axes x quantities)."""
        times = np.stack([rows[f"{name}_ns"] * 1e-3 for name in _TIMES], axis=1)
        values = np.concatenate([times, quantities], axis=1)
        at = 0
        while at < len(rows):
            now_ns = int(rows["time_ns"][at])
            if self._second.is_empty or now_ns >= self._end_ns:
                self._close_second()
                self._open_second(now_ns)
            until = int(np.searchsorted(rows["time_ns"], self._end_ns))
            self._second.add(rows[at:until], values[at:until], self._period_ns)
            at = until

    def end(self) -> None:
        """Nothing more comes: the second and the minute that are under way are lines, too."""
        self._close_second()
        self._close_minute()

    def _none(self) -> Summary:
        return Summary(self._columns, len(self._watched))

    def _open_second(self, now_ns: int) -> None:
        unix_ns = now_ns + self._offset_ns()
        self._began_s = unix_ns // _NS
        self._end_ns = now_ns + _NS - unix_ns % _NS
        if self._began_s // 60 != self._minute_s // 60:
            self._close_minute()
            self._minute_s = self._began_s // 60 * 60

    def _close_second(self) -> None:
        if not self._second.is_empty:
            self._line(SECOND, self._began_s, self._second)
            self._minute.join(self._second)
            self._second = self._none()

    def _close_minute(self) -> None:
        if not self._minute.is_empty:
            self._line(MINUTE, self._minute_s, self._minute)
            self._minute = self._none()

    def _line(self, every: str, unix_s: int, summary: Summary) -> None:
        stamp = datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%dT%H:%M:%S")
        self._put(every, stamp[:10], table_line([stamp, *summary.cells(self._watched)]))
