"""Samples that are wrong by themselves: spikes of a few samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .table import Array

Flags = NDArray[np.bool_]

_WINDOW = 7
"""Samples of the running median: a spike of up to three samples stands out of it."""
_DEVIATIONS, _OTHERS, _SPAN = 12.0, 4.0, 0.01
"""A spike is so many standard deviations of what the median leaves, so many times what it leaves elsewhere (its
quantile `_USUAL`), and that share of the signal's span away."""
_USUAL = 0.97
_MOST = 0.02
"""More than this share of all samples are no spikes, but how the signal is."""


def off_median(x: Array) -> Array:
    """How far each sample (n,) is from the median of those around it."""
    return np.asarray(np.abs(x - _median(x)))


def find_spikes(x: Array) -> Flags:
    """Samples (n,) of a signal `x` (n,) that leave it for up to three samples and come back.

    A signal that jumps often by itself (a binary sequence, noise) has none: nothing in it is unusual.
    """
    away = off_median(x)
    scale = float(np.median(away)) / 0.6745
    steps = np.abs(np.diff(x))
    finest = float(steps[steps > 0].min()) if np.any(steps > 0) else 0.0
    low, high = np.quantile(x, [0.005, 0.995])
    usual = float(np.quantile(away, _USUAL))
    limit = max(_DEVIATIONS * max(scale, finest), _OTHERS * usual, _SPAN * float(high - low))
    found = away > limit
    # those beside a spike have it in their median: once more without it
    around = _median(bridged(x, np.asarray(found)))
    found &= np.abs(x - around) > limit
    if finest == 0.0 or scale == 0.0 == usual or np.mean(found) > _MOST:
        return np.zeros(len(x), dtype=bool)
    return np.asarray(found)


def bridged(x: Array, flags: Flags) -> Array:
    """`x` (n,) with straight lines over the samples that are flagged."""
    if not flags.any() or flags.all():
        return x
    at = np.arange(len(x))
    return np.where(flags, np.interp(at, at[~flags], x[~flags]), x)


def _median(x: Array) -> Array:
    """The running median; scipy is loaded with the first: who only writes recordings does without."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(x, _WINDOW, mode="nearest"), float)
