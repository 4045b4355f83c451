"""Signals about zero, on a grid far finer than any sensor's digit.

A search for the best model takes another way where rounding differs, and may end elsewhere. So that nothing it finds
depends on where a sensor has its zero, it sees numbers that are the same, to the last bit, wherever that is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_GRID = 2.0**24


def span(signal: Array) -> tuple[float, float]:
    """Middle and half width of a signal (n,), the width to 24 bits."""
    low, high = float(signal.min()), float(signal.max())
    return 0.5 * (low + high), float(np.float32(0.5 * (high - low)))


def about_zero(signal: Array, middle: float, half: float) -> Array:
    """`signal` (n,) less `middle`, in steps of 2^-24 of `half`."""
    return np.asarray(np.rint((signal - middle) / half * _GRID) / _GRID * half)
