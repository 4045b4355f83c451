"""What is kept of a series that is read once, part after part, each in order and of any length."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import spectrogram

from micromanip.control.system import Array

_SPECTRUM_S = 1.0
_COUNTED_NS = 1 << 20


class Spectra:
    """Power densities of segments of 1 s that overlap by a half; their mean is Welch's. Hann window."""

    def __init__(self, rate_Hz: float, bands_Hz: Sequence[tuple[float, float]]) -> None:
        self._rate_Hz, self._bands_Hz = rate_Hz, bands_Hz
        self._segment = round(_SPECTRUM_S * rate_Hz)
        self._rest, self._sum, self._bands = np.empty(0), np.empty(0), [np.empty((0, len(bands_Hz)))]
        self._frequency, self._count = np.empty(0), 0

    def add(self, values: Array) -> None:
        """Samples (n,) that follow."""
        values = np.concatenate([self._rest, values])
        half = self._segment // 2
        taken = max(0, (len(values) - self._segment) // (self._segment - half) + 1)
        if taken:
            self._take(values[: (taken - 1) * (self._segment - half) + self._segment], self._segment)
        self._rest = values[taken * (self._segment - half) :]

    def end(self) -> None:
        """Nothing follows: what is shorter than a segment is taken as one, where there is nothing else."""
        if not self._count and len(self._rest):
            self._take(self._rest, len(self._rest))

    def _take(self, values: Array, segment: int) -> None:
        frequency, _, density = spectrogram(values, self._rate_Hz, "hann", segment, segment // 2, detrend="constant")
        self._frequency, self._count = frequency, self._count + density.shape[1]
        self._sum = density.sum(axis=1) + (self._sum if len(self._sum) else 0.0)
        step = float(frequency[1])
        inside = [(frequency >= low) & (frequency < high) for low, high in self._bands_Hz]
        self._bands.append(np.stack([density[band].sum(axis=0) * step for band in inside], axis=1))

    @property
    def frequency_Hz(self) -> Array:
        """(f,)"""
        return self._frequency

    @property
    def density(self) -> Array:
        """(f,), the mean of all segments."""
        return self._sum / self._count

    @property
    def power(self) -> Array:
        """Of each segment and band (segments, bands)."""
        return np.concatenate(self._bands)


class Counts:
    """How often each whole number came: percentiles are exact. Few are below 0, or 2^20 and more."""

    def __init__(self) -> None:
        self._counts = np.zeros(_COUNTED_NS, np.int64)
        self._outside: list[NDArray[np.int64]] = []

    def add(self, values: NDArray[Any]) -> None:
        """Whole numbers (n,)."""
        inside = (values >= 0) & (values < _COUNTED_NS)
        self._counts += np.bincount(values[inside].astype(np.int64), minlength=_COUNTED_NS)
        self._outside.append(values[~inside].astype(np.int64))

    def sorted(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The values that came, in order, and how many are up to and with each."""
        outside, often = np.unique(np.concatenate([np.empty(0, np.int64), *self._outside]), return_counts=True)
        inside = np.flatnonzero(self._counts)
        values = np.concatenate([outside[outside < 0], inside, outside[outside >= 0]])
        counts = np.concatenate([often[outside < 0], self._counts[inside], often[outside >= 0]])
        return values, np.cumsum(counts)

    def percentiles(self, percents: Sequence[float]) -> list[float]:
        """As NumPy's: straight between the two nearest in rank."""
        values, ranks = self.sorted()
        places = np.array(percents) / 100.0 * (ranks[-1] - 1)
        low = values[np.searchsorted(ranks, np.floor(places), side="right")]
        high = values[np.searchsorted(ranks, np.ceil(places), side="right")]
        found: list[float] = (low + (high - low) * (places % 1.0)).tolist()
        return found


class Sections:
    """`of_section` of each whole section of `length` samples: (sections, length) to (sections, ...)."""

    def __init__(self, length: int, of_section: Callable[[Array], Array]) -> None:
        self._length, self._of_section = length, of_section
        self._found: list[Array] = []
        self._rest = np.empty(0)

    def add(self, values: Array) -> None:
        """Samples (n,) that follow."""
        values = np.concatenate([self._rest, values])
        whole = len(values) // self._length * self._length
        if whole:
            self._found.append(self._of_section(values[:whole].reshape(-1, self._length)))
        self._rest = values[whole:]

    @property
    def found(self) -> Array:
        """Of each whole section, in order."""
        return np.concatenate(self._found) if self._found else np.empty(0)
