"""Spectra in physical units, by Welch's method (P. Welch, IEEE Trans. Audio Electroacoust. 15(2), 1967).

The density, in units per sqrt(Hz), is made with Hann's window, as noise is read from it. The amplitude of lines is read
with a flat-top window, whose error between two bins is below 0.1 %; with Hann's it would be up to 15 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST = 64
"""Samples below which there is no spectrum."""
_AVERAGES = 8
_LINES = 5
_FLOOR = 4.0
"""A line stands out of the median of its neighbours by this factor, in amplitude."""
_AROUND = 25
_APART = 5
"""Bins from one line to the next at least."""


@dataclass(frozen=True)
class Line:
    """A sine in the signal: its frequency and peak amplitude, in the signal's unit."""

    frequency_Hz: float
    amplitude: float


@dataclass(frozen=True)
class Spectrum:
    """`density` (n) in units per sqrt(Hz) at `frequency_Hz` (n), the greatest lines, and `averages` segments."""

    frequency_Hz: Array
    density: Array
    lines: list[Line]
    averages: int


def on_grid(cycles: NDArray[np.int64], values: Array) -> tuple[Array, float]:
    """Values (n) at every cycle from the first to the last, and which share of them was not there.

    Cycles that the loop skipped, and values that are not finite, are drawn straight between their neighbours.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(0), 1.0
    grid = np.arange(cycles[0], cycles[-1] + 1)
    filled = np.interp(grid, cycles[known], values[known])
    return filled, 1.0 - float(np.count_nonzero(known)) / len(grid)


def spectrum(values: Array, rate_Hz: float) -> Spectrum | None:
    """Of `values` (n) taken at `rate_Hz`; None where they are too few. The mean is taken off each segment."""
    from scipy.signal import welch  # as long to import as all else of the gateway, which imports it meanwhile

    if len(values) < LEAST:
        return None
    # n samples are `averages` segments that overlap by a half
    segment = min(len(values), max(LEAST, 2 * len(values) // (_AVERAGES + 1)))
    averages = max(1, (len(values) - segment) // (segment // 2) + 1)
    frequency, power = welch(values, rate_Hz, "hann", segment)
    _, square = welch(values, rate_Hz, "flattop", segment, scaling="spectrum")
    return Spectrum(frequency, np.sqrt(power), _lines(power, np.sqrt(2.0 * square), rate_Hz / segment), averages)


def _lines(power: Array, amplitude: Array, bin_Hz: float) -> list[Line]:
    """The greatest peaks that stand out; frequencies are interpolated."""
    from scipy.signal import find_peaks

    logarithm = np.log(np.maximum(power, np.finfo(float).tiny))
    found: list[Line] = []
    for k in sorted(find_peaks(power, distance=_APART)[0], key=lambda k: -power[k]):
        around = amplitude[max(1, k - _AROUND) : k + _AROUND + 1]
        if k > 1 and amplitude[k] >= _FLOOR * np.median(around):
            left, mid, right = logarithm[k - 1 : k + 2]
            curve = left - 2.0 * mid + right
            shift = 0.5 * (left - right) / curve if curve < 0.0 else 0.0
            found.append(Line(float((k + shift) * bin_Hz), float(amplitude[k - 1 : k + 2].max())))
    return found[:_LINES]
