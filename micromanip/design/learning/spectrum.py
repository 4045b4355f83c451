"""Which frequencies of the error repeat: powers in bands, their spread from part to part, and a confidence for each.

In a band of the mean of n parts with power S, of which the spread R from part to part leaves R / n by chance, the
share that repeats is estimated without bias by ``1 - R / (n S)``: that is Wiener's gain for it. R is the larger of the
band's own spread and that of the bands about it: the own is small by chance in one band of so many, and that band would
be believed. A share is taken where S is beyond what chance makes, anywhere in the whole spectrum, of the spread about
it in 99 of 100 updates, and of its own in 99 of 100 bands (F distribution); elsewhere it is 0: what is not sure is not
played. Of a single part the spread is not known; the median of the bands about it stands for R, so that only lines are
seen, and half is taken of what may after all be chance.
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
_NEXT, _NEXT_BUT_ONE = 4.0 / 9.0, 1.0 / 36.0
"""Of a line's power, behind a Hann window, what it has in common with its neighbours on either side."""
_ABOUT, _OF_THEM = 11, 7.0
"""Bands whose median is the floor about a line; how many they tell of, as a median tells less than a mean."""
_CHANCE, _OWN_CHANCE = 0.01, 0.01
"""That any band of an update is taken by chance, as it would play noise; that one is by its own spread."""
_FIRST_SHARE = 0.5


class Bands:
    """Bands of the spectrum of `values` values, `rate_hz` a second, up to `highest_hz`."""

    def __init__(self, values: int, rate_hz: float, highest_hz: float) -> None:
        """The highest band lies below `highest_hz` as a whole."""
        seconds = values / rate_hz
        self._lines = max(_LINES, round(_LEAST_HZ * seconds))
        self.count = max(0, int(highest_hz * seconds) // self._lines)
        self.width_hz = self._lines / seconds
        lines, common = self._lines, (self._lines - 1) * _NEXT + (self._lines - 2) * _NEXT_BUT_ONE
        self._independent = 2.0 * lines**2 / (lines + 2.0 * common)
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
        return believed(power, power if parts < 2 else spread, parts, self._independent)

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


def believed(power: Array, spread: Array, parts: int, independent: float) -> Array:
    """Share (n,), 0 to 1, of the mean of `parts` parts that repeats, of its `power` and the `spread`, line by line.

    `independent`: degrees of freedom of each in a part. Of a single part `spread` is its power.
    """
    single, after = parts < 2, max(1, parts - 1)
    own = independent * (1.0 if single else after)
    # the median of chi square lies below its mean
    about = median_filter(spread, _ABOUT, mode="reflect") / (1.0 - 2.0 / (9.0 * own)) ** 3
    beyond = _times(power * parts, about)
    sure = beyond > fisher.isf(_CHANCE / max(1, len(power)), independent, _OF_THEM * own)
    if single:
        return np.asarray(np.where(sure, _FIRST_SHARE * (1.0 - 1.0 / np.maximum(beyond, 1.0)), 0.0))
    itself = _times(power * parts, spread)
    sure &= itself > fisher.isf(_OWN_CHANCE, independent, own)
    return np.asarray(np.where(sure, 1.0 - 1.0 / np.maximum(np.minimum(beyond, itself), 1.0), 0.0))


def _times(power: Array, floor: Array) -> Array:
    """How many times its `floor` (bands,) a `power` is; infinite above none, 0 where both are."""
    nothing = np.where(power > 0.0, np.inf, 0.0)
    return np.asarray(np.divide(power, floor, out=nothing, where=floor > 0.0))
