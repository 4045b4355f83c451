"""Histogram of durations with bounded relative error, filled inside the loop.

Each power of two is split into 32 equal bins, so a percentile is good to 3 %; below 32 ns the bins are 1 ns.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .jit import compiled

SPLIT = 32
BINS = SPLIT * 60
_SPLIT_BITS = 5


@compiled
def bin_of(value: int) -> int:
    """Bin of a duration (ns); negative ones count as 0."""
    if value < SPLIT:
        return max(0, value)
    exponent = math.frexp(float(value))[1] - 1
    shift = exponent - _SPLIT_BITS
    return min(BINS - 1, (shift + 1) * SPLIT + (value >> shift) - SPLIT)


@compiled
def lower_edge(index: int) -> int:
    """Smallest duration (ns) that falls into bin `index`."""
    if index < SPLIT:
        return index
    shift = index // SPLIT - 1
    return (SPLIT + index % SPLIT) << shift


@compiled
def count(histogram: Any, value: int) -> None:
    """Add one duration (ns)."""
    histogram[bin_of(value)] += 1


def percentile(histogram: Any, fraction: float) -> int:
    """Smallest bin edge (ns) that at least `fraction` of all values do not exceed by a bin; 0 when empty."""
    seen = np.cumsum(histogram)
    if seen[-1] == 0:
        return 0
    return lower_edge(int(np.searchsorted(seen, max(1, math.ceil(fraction * seen[-1])))))
