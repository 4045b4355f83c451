"""How well a figure of a run is known, and whether that of another run differs: with correlated samples.

Samples of a control error follow one another: 10,000 a second are not 10,000 observations. A mean is taken of batches
that are long beside the memory of what is averaged (method of batch means: Law and Kelton, Simulation Modeling and
Analysis, section 9.5); its spread over the batches says how well it is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from micromanip.errors import CheckFailed

Array = NDArray[np.float64]

FEWEST = 8
"""Batches below which nothing is said of a spread."""
_MOST = 64
_MEMORY = 0.2
"""Correlation of neighbouring batches up to which they count as independent."""
_LEAST_SAMPLES = 200
LOWER, HIGHER, SAME = "lower", "higher", "no difference shown"


@dataclass(frozen=True)
class Mean:
    """A mean, the standard error of it, and of how many independent batches."""

    value: float
    standard_error: float
    batches: int

    @property
    def root(self) -> float:
        """Of a mean square: the rms."""
        return float(np.sqrt(self.value))


def mean_square(squares: Array, samples: int) -> Mean:
    """Of the squares of so many samples in order, or of means of equal blocks of them. CheckFailed for too few."""
    if samples < _LEAST_SAMPLES:
        raise CheckFailed(f"{samples} cycles of tracking are too few to judge; at least {_LEAST_SAMPLES} are needed")
    return batch_mean(squares)


def batch_mean(values: Array) -> Mean:
    """Of `values` (n,) in order, of which there are `FEWEST` at least.

    Where even the longest batches are correlated, the standard error is widened as for a first-order process.
    """
    count = min(_MOST, len(values))
    means = values
    while count >= FEWEST:
        means = values[: len(values) // count * count].reshape(count, -1).mean(axis=1)
        if _neighbours(means) < max(_MEMORY, 1.0 / np.sqrt(count)):
            break
        count //= 2
    left = min(max(_neighbours(means), 0.0), 0.9)  # what they still have of each other
    spread = float(np.std(means, ddof=1)) * np.sqrt((1 + left) / (1 - left) / len(means))
    return Mean(float(np.mean(values)), spread, len(means))


def _neighbours(means: Array) -> float:
    """Correlation of each with the next."""
    deviation = means - means.mean()
    total = float(deviation @ deviation)
    return float(deviation[1:] @ deviation[:-1]) / total if total > 0 else 0.0


@dataclass(frozen=True)
class Difference:
    """`value` of the second run beside the first, in `low` to `high` with 95 % confidence; `same` is no change."""

    value: float
    low: float
    high: float
    same: float

    @property
    def verdict(self) -> str:
        """What can be said: lower, higher, or that these runs show no difference."""
        if self.high < self.same:
            return LOWER
        return HIGHER if self.low > self.same else SAME


def ratio(first: Mean, second: Mean) -> Difference:
    """Of the rms of two mean squares, by Welch's test on their logarithms."""
    if first.value == 0 or second.value == 0:
        same = first.value == second.value
        return Difference(1.0, 1.0, 1.0, 1.0) if same else Difference(np.inf, 0.0, np.inf, 1.0)
    errors = [each.standard_error / each.value for each in (first, second)]
    half = 0.5 * _half_width(errors, first, second)
    found = second.root / first.root
    return Difference(found, found * float(np.exp(-half)), found * float(np.exp(half)), 1.0)


def change(first: Mean, second: Mean) -> Difference:
    """By how much a mean is larger, by Welch's test."""
    half = _half_width([first.standard_error, second.standard_error], first, second)
    found = second.value - first.value
    return Difference(found, found - half, found + half, 0.0)


def _half_width(errors: Sequence[float], first: Mean, second: Mean) -> float:
    """Of the 95 % interval of a difference of two values with these standard errors; freedom by Welch-Satterthwaite."""
    parts = [error**2 for error in errors]
    variance = sum(parts)
    freedom = variance**2 / max(
        sum(part**2 / (each.batches - 1) for part, each in zip(parts, (first, second), strict=True)), 1e-300
    )
    return float(student.ppf(0.975, max(freedom, 1.0)) * np.sqrt(variance))
