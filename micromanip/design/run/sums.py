"""What is kept of a series that is read once, part after part: no more of an hour than of a minute.

Each of these takes its samples in order, in parts of any length. Where there would be too many entries two neighbours
become one, so that a short run keeps every sample, and a long one as many entries as can be seen or judged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import spectrogram

Array = NDArray[np.float64]

_SPECTRUM_S = 1.0
_COUNTED_NS = 1 << 20


class BlockMeans:
    """Means of blocks of `per` samples: of one each, until there would be more than `most` of them."""

    def __init__(self, most: int = 1 << 20) -> None:
        self.per, self._most = 1, most
        self._means: list[Array] = []
        self._blocks, self._rest = 0, np.empty(0)

    def add(self, values: Array) -> None:
        """Samples (n,) that follow."""
        values = np.concatenate([self._rest, values])
        whole = len(values) // self.per * self.per
        self._means.append(values[:whole].reshape(-1, self.per).mean(axis=1))
        self._rest = values[whole:]
        self._blocks += len(self._means[-1])
        while self._blocks > self._most:
            means = self.means
            even = len(means) // 2 * 2
            self._means = [means[:even].reshape(-1, 2).mean(axis=1)]
            self._rest = np.concatenate([np.repeat(means[even:], self.per), self._rest])
            self.per, self._blocks = 2 * self.per, even // 2

    @property
    def means(self) -> Array:
        """Of the blocks so far; samples behind the last whole one are left out."""
        self._means = [np.concatenate([np.empty(0), *self._means])]
        return self._means[0]


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
    """`of_section` of each section of `length` samples: (sections, length) to (sections, ...)."""

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


class Envelope:
    """Least and greatest known value of each column of pixels: between `columns` and twice as many."""

    def __init__(self, series: int, columns: int = 600) -> None:
        self._columns, self._per, self._rows = columns, 1, 0
        self._begin = np.empty(0, np.int64)
        self._low = self._high = np.empty((series, 0))

    def add(self, cycles: NDArray[np.int64], values: Array) -> None:
        """Rows (n,) that follow, their values (series, n)."""
        if not len(cycles):
            return
        place = (self._rows + np.arange(len(cycles))) // self._per
        begins = np.flatnonzero(np.diff(place, prepend=-1))
        low, high = np.fmin.reduceat(values, begins, axis=1), np.fmax.reduceat(values, begins, axis=1)
        follows = self._rows % self._per != 0
        if follows:
            self._low[:, -1] = np.fmin(self._low[:, -1], low[:, 0])
            self._high[:, -1] = np.fmax(self._high[:, -1], high[:, 0])
        new = slice(int(follows), None)
        self._begin = np.concatenate([self._begin, cycles[begins][new]])
        self._low = np.concatenate([self._low, low[:, new]], axis=1)
        self._high = np.concatenate([self._high, high[:, new]], axis=1)
        self._rows += len(cycles)
        while len(self._begin) > 2 * self._columns:
            pairs = np.arange(0, len(self._begin), 2)
            self._per, self._begin = 2 * self._per, self._begin[pairs]
            self._low = np.fmin.reduceat(self._low, pairs, axis=1)
            self._high = np.fmax.reduceat(self._high, pairs, axis=1)

    def of(self, place: int) -> tuple[NDArray[np.int64], Array, Array]:
        """First cycle of each column, least and greatest value of a series, where one is known."""
        known = np.isfinite(self._low[place])
        return self._begin[known], self._low[place][known], self._high[place][known]


class Picked:
    """Every so many-th row of some columns: between `most` / 2 and `most` of them."""

    def __init__(self, series: int, most: int = 3000) -> None:
        self._every, self._rows, self._most = 1, 0, most
        self.values = np.empty((series, 0))

    def add(self, values: Array) -> None:
        """Rows (series, n) that follow."""
        first = -self._rows % self._every
        self.values = np.concatenate([self.values, values[:, first :: self._every]], axis=1)
        self._rows += values.shape[1]
        while self.values.shape[1] > self._most:
            self.values, self._every = self.values[:, ::2], 2 * self._every
