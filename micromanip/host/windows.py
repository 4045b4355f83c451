"""Figures of the last second and the last minute, of any number of columns, in memory that does not grow.

Values are summed up in blocks of a tenth of a second. A window is the blocks that end with the present one, so the
oldest values leave it a block at a time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from micromanip.status_reply import Window

BLOCK_NS = 100_000_000
_BLOCKS = 600
"""A minute."""

DIGITS = 5
"""Ten picometres, or 10 uV."""

Array = NDArray[np.float64]


class Windows:
    """Of `columns` quantities; a value that is not finite is unknown, and counts nowhere."""

    def __init__(self, columns: int) -> None:
        self._block = np.full(_BLOCKS, -1, np.int64)
        """Number of the block, its time over its length, that each place holds."""
        self._counts = np.zeros((_BLOCKS, columns), np.int64)
        self._sums, self._squares = np.zeros((2, _BLOCKS, columns))
        self._low, self._high = np.zeros((2, _BLOCKS, columns))

    def add(self, time_ns: NDArray[np.int64], values: Array) -> None:
        """Take in `values` (n, columns) of the rising times `time_ns` (n)."""
        if not len(time_ns):
            return
        numbers = time_ns // BLOCK_NS
        starts = np.r_[0, np.flatnonzero(np.diff(numbers)) + 1]
        known = np.isfinite(values)
        finite = np.where(known, values, 0.0)
        added = (
            np.add.reduceat(known.astype(np.int64), starts),
            np.add.reduceat(finite, starts),
            np.add.reduceat(finite * finite, starts),
            np.minimum.reduceat(np.where(known, values, np.inf), starts),
            np.maximum.reduceat(np.where(known, values, -np.inf), starts),
        )
        for number, count, total, squares, low, high in zip(numbers[starts], *added, strict=True):
            k = number % _BLOCKS
            if self._block[k] != number:
                self._block[k] = number
                self._counts[k] = self._sums[k] = self._squares[k] = 0
                self._low[k], self._high[k] = np.inf, -np.inf
            self._counts[k] += count
            self._sums[k] += total
            self._squares[k] += squares
            self._low[k] = np.minimum(self._low[k], low)
            self._high[k] = np.maximum(self._high[k], high)

    def over(self, seconds: float, now_ns: int) -> list[Window | None]:
        """Figures of each column over the last `seconds` before `now_ns`; None where nothing was known."""
        last = now_ns // BLOCK_NS
        inside = (self._block > last - round(seconds * 1e9 / BLOCK_NS)) & (self._block <= last)
        counts = self._counts[inside]
        totals = zip(
            counts.sum(0).tolist(),
            np.count_nonzero(counts, axis=0).tolist(),
            self._sums[inside].sum(0).tolist(),
            self._squares[inside].sum(0).tolist(),
            self._low[inside].min(0, initial=np.inf).tolist(),
            self._high[inside].max(0, initial=-np.inf).tolist(),
            strict=True,
        )
        return [_window(*each) for each in totals]


def _window(count: int, blocks: int, total: float, squares: float, least: float, most: float) -> Window | None:
    if count == 0:
        return None
    mean, square = total / count, squares / count
    return {
        "seconds": round(blocks * BLOCK_NS * 1e-9, 1),
        "mean": round(mean, DIGITS),
        "min": round(least, DIGITS),
        "max": round(most, DIGITS),
        "rms": round(math.sqrt(square), DIGITS),
        "peak": round(max(abs(least), abs(most)), DIGITS),
        "deviation_rms": round(math.sqrt(max(0.0, square - mean * mean)), DIGITS),
        "deviation_peak": round(max(most - mean, mean - least), DIGITS),
    }
