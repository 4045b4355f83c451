"""Which frequencies of the error repeat: powers in bands, their spread from part to part, and a confidence for each.

In a band of the mean of n parts with power S, of which the spread R from part to part leaves R / n by chance, the
share that repeats is estimated without bias by ``1 - R / (n S)``: that is Wiener's gain for it. It is taken where S
is beyond what chance makes of R in 999 of 1000 cases (F distribution), and is 0 elsewhere: what is not sure is not
played. Of a single part the spread is not known; the median of the bands about it stands for R, so that only lines
are seen, and half is taken of what may after all be chance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.stats import f as fisher

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LINES, _LEAST_HZ = 8, 0.5
"""A band has so many lines at least, and is as wide at least."""
_INDEPENDENT = 2.0 / 3.0
"""Of the lines, behind a Hann window."""
_ABOUT = 11
"""Bands whose median is the floor about a line."""
_SURE = 0.999
"""There are some 75 bands, and one that is taken by chance plays noise."""
_FIRST_SHARE = 0.5


class Bands:
    """Bands of the spectrum of `values` values, `rate_hz` a second, up to `highest_hz`."""

    def __init__(self, values: int, rate_hz: float, highest_hz: float) -> None:
        """The highest band lies below `highest_hz` as a whole."""
        seconds = values / rate_hz
        self._lines = max(_LINES, round(_LEAST_HZ * seconds))
        self.count = max(0, int(highest_hz * seconds) // self._lines)
        self.width_hz = self._lines / seconds
        window = np.hanning(values)
        self._window = window / np.sqrt(np.sum(window**2) * values)

    def spectrum(self, x: Array) -> Complex:
        """Lines (bands, lines) of `x` (n,): the sum of their squares is its mean square, one sided."""
        found = np.sqrt(2.0) * np.fft.rfft(self._window * x)
        return np.asarray(found[: self.count * self._lines].reshape(self.count, self._lines))

    def power(self, x: Array) -> Array:
        """Mean square (bands,) of `x` (n,)."""
        return np.asarray(np.sum(np.abs(self.spectrum(x)) ** 2, axis=1))

    def confidence(self, power: Array, spread: Array, parts: int) -> Array:
        """Share (bands,), 0 to 1, of the mean of `parts` parts that repeats, of its `power` and the `spread`."""
        independent = 2.0 * self._lines * _INDEPENDENT
        single = parts < 2
        floor = median_filter(power, _ABOUT, mode="nearest") if single else spread / parts
        ratio = np.divide(power, floor, out=np.full_like(power, np.inf), where=floor > 0.0)
        least = fisher.ppf(_SURE, independent, independent * (_ABOUT if single else parts - 1))
        share = np.where((ratio > least) & (power > 0.0), 1.0 - 1.0 / ratio, 0.0)
        return np.asarray((_FIRST_SHARE if single else 1.0) * share)

    def gain(self, share: Array, hertz: Array) -> Array:
        """`share` (bands,) at `hertz` (n,): whole in its band, so that a line near an end is, and falling beside it."""
        place = hertz / self.width_hz
        band = np.floor(place).astype(int)
        into = place - band
        padded = np.concatenate([np.zeros(1), share, np.zeros(2)])
        below, own, above = (padded[np.clip(band + k, 0, self.count + 1)] for k in (0, 1, 2))
        return np.asarray(np.maximum(own, np.maximum(below * (1.0 - 2.0 * into), above * (2.0 * into - 1.0))))

    def named(self, share: Array) -> tuple[tuple[float, float], ...]:
        """From and to (Hz) of the bands in a row of which something is taken."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], share > 0.0, [0]])))
        return tuple((float(low * self.width_hz), float(high * self.width_hz)) for low, high in edges.reshape(-1, 2))
