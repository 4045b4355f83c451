"""Histogram of ages, for percentiles that cost the same however long a run was and however its ages spread."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SPLIT_BITS = 8
_SPLIT = 1 << _SPLIT_BITS
_OCTAVES = 40
"""Ages in us: twelve days."""


class Ages:
    """Ages (us): each power of two is split into 256 equal bins, so percentiles are good to .4 %, to 512 us exact."""

    def __init__(self) -> None:
        self.maximum: int | None = None
        self._counts = np.zeros(_SPLIT * (_OCTAVES - _SPLIT_BITS + 1), np.int64)

    def add(self, ages_us: NDArray[np.int64]) -> None:
        """Count some more; negative ones as 0."""
        if not len(ages_us):
            return
        ages_us = np.maximum(ages_us, 0)
        oldest = int(ages_us.max())
        self.maximum = oldest if self.maximum is None else max(self.maximum, oldest)
        shift = np.maximum(np.frexp(ages_us.astype(float))[1] - 1 - _SPLIT_BITS, 0)
        bins = np.minimum(shift * _SPLIT + (ages_us >> shift), len(self._counts) - 1)
        self._counts += np.bincount(bins, minlength=len(self._counts))

    def percentile(self, share: float) -> int | None:
        """Lower edge (us) of the bin up to which there are `share` of all; None without any."""
        seen = np.cumsum(self._counts)
        if seen[-1] == 0:
            return None
        index = int(np.searchsorted(seen, max(1.0, share * seen[-1])))
        shift = max(0, index // _SPLIT - 1)
        return (index - shift * _SPLIT) << shift
