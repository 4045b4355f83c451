"""Samples on another grid, each piece between gaps by itself: monotone cubics, low-passed before it is thinned."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .clock import Clock
from .spikes import bridged
from .table import Array

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Samples = tuple[Index, Array, Flags]

_TAPS = 10
"""Half length of the low-pass, in samples of the result."""
_PASSED = 0.8
"""Edge of the low-pass, share of half the new rate."""


def onto_grid(clock: Clock, values: Array, spikes: Flags) -> Samples:
    """Samples (n, k) of a jittering clock at the nearest grid points that lie among them; an even clock's as they are.

    Gaps of two intervals and more stay gaps.
    """
    if not clock.jittered:
        return clock.index, values, spikes
    found = []
    at = clock.seconds / clock.step_s
    for piece in _pieces(at, 2.5):
        grid = np.arange(int(np.ceil(at[piece.start] - 1e-6)), int(np.floor(at[piece.stop - 1] + 1e-6)) + 1)
        found.append(_between(at[piece], values[piece], spikes[piece], grid, np.asarray(grid, dtype=float)))
    return _joined(found)


def resampled(index: Index, values: Array, spikes: Flags, step_s: float, new_step_s: float) -> Samples:
    """Samples (n, k) every `new_step_s`."""
    ratio = new_step_s / step_s
    smooth = np.column_stack([bridged(column, flags) for column, flags in zip(values.T, spikes.T, strict=True)])
    found = []
    for piece in _pieces(index.astype(float), 1.5):
        part = _low_passed(smooth[piece], ratio) if ratio > 1.0 else smooth[piece]
        first, last = index[piece.start] / ratio, index[piece.stop - 1] / ratio
        grid = np.arange(int(np.ceil(first - 1e-9)), int(np.floor(last + 1e-9)) + 1)
        found.append(
            _between(index[piece].astype(float), part, spikes[piece], grid, np.asarray(grid * ratio, dtype=float))
        )
    return _joined(found)


def _pieces(at: Array, gap: float) -> Iterator[slice]:
    ends = [0, *(np.flatnonzero(np.diff(at) > gap) + 1).tolist(), len(at)]
    for first, last in pairwise(ends):
        if last - first >= 2:
            yield slice(first, last)


def _between(at: Array, values: Array, spikes: Flags, grid: Index, where: Array) -> Samples:
    from scipy.interpolate import PchipInterpolator

    inside = (where >= at[0] - 1e-9) & (where <= at[-1] + 1e-9)
    grid, where = grid[inside], np.clip(where[inside], at[0], at[-1])
    nearest = np.clip(np.searchsorted(at, where), 1, len(at) - 1)
    flags = spikes[nearest] | spikes[nearest - 1]
    return grid, np.asarray(PchipInterpolator(at, values)(where)), flags


def _joined(found: list[Samples]) -> Samples:
    index, values, flags = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return index, values, flags


def _low_passed(values: Array, ratio: float) -> Array:
    """Without delay; what lies before and behind is continued through the ends."""
    from scipy.signal import firwin

    half = min(int(np.ceil(_TAPS * ratio)), len(values) - 1)
    taps = firwin(2 * half + 1, _PASSED / ratio)
    ahead, behind = 2 * values[:1] - values[half:0:-1], 2 * values[-1:] - values[-2 : -half - 2 : -1]
    long = np.vstack([ahead, values, behind])
    return np.column_stack([np.convolve(column, taps, "valid") for column in long.T])
