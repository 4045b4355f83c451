"""Whether innovations are what a filter takes for granted: white, and of the variance that it states.

NIS is the mean of ``e^2 / v``: n times it has a chi-square distribution of n degrees (Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, section 5.4). The autocorrelations of white innovations are
normal with variance 1/n; the largest of several lags is held against a bound for all of them together (Bonferroni).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

Array = NDArray[np.float64]

_WRONGLY = 0.01
"""How often good innovations are refused, each way."""
_LAGS = 20


@dataclass(frozen=True)
class Whiteness:
    """NIS with its bounds, and the largest autocorrelation of lags 1 to 20 with its bound."""

    nis: float
    nis_bounds: tuple[float, float]
    correlation: float
    lag: int
    correlation_bound: float

    @property
    def white(self) -> bool:
        """Whether none of the lags stands out."""
        return abs(self.correlation) <= self.correlation_bound

    @property
    def as_stated(self) -> bool:
        """Whether the variance is the stated one."""
        return self.nis_bounds[0] <= self.nis <= self.nis_bounds[1]


def judge_innovations(innovations: Array, variance_um2: float) -> Whiteness:
    """Of innovations (n,), um, whose variance is stated as `variance_um2`; n above 20."""
    n = len(innovations)
    power = float(np.sum(innovations**2))
    lags = np.array([float(innovations[k:] @ innovations[:-k]) for k in range(1, _LAGS + 1)]) / power
    worst = int(np.argmax(np.abs(lags)))
    low, high = (chi2.ppf(share, n) / n for share in (0.5 * _WRONGLY, 1.0 - 0.5 * _WRONGLY))
    bound = float(norm.ppf(1.0 - 0.5 * _WRONGLY / _LAGS) / np.sqrt(n))
    return Whiteness(power / n / variance_um2, (float(low), float(high)), float(lags[worst]), worst + 1, bound)
