"""A CUSUM that needs no time of learning, with a false-alarm rate that is known: Hawkins, J. Qual. Technol. 19 (1987).

Each value is put beside the mean and the deviation of those before it. For independent normal values of whatever mean
and deviation, Student's t of that, put through its distribution function, is exactly standard normal from the third on,
and what it adds up to is a CUSUM of known run length (Siegmund 1985).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm, t

ALLOWANCE = 0.5
"""Half of the shift, in deviations, that it is quickest to see."""
_LARGEST, _SIEGMUND = 8.0, 1.166
_FIRST, _STRANGE = 3, 3.0
"""Values before anything is said; deviations beyond which one is judged, but not learned from."""


def average_run_length(limit: float, allowance: float = ALLOWANCE) -> float:
    """Values between two false alarms of one side, without a shift (Siegmund's approximation)."""
    b = limit + _SIEGMUND
    return (math.exp(2 * allowance * b) - 2 * allowance * b - 1) / (2 * allowance**2)


def limit_for(run_length: float, allowance: float = ALLOWANCE) -> float:
    """The limit that one side crosses falsely once in `run_length` values; never below that of 10."""
    return float(brentq(lambda h: average_run_length(h, allowance) - max(run_length, 10.0), 0.0, 50.0))


class Cusum:
    """Two-sided; values are given one after another, and one that crossed a limit goes on standing there."""

    def __init__(self, limit: float, allowance: float = ALLOWANCE) -> None:
        """Nothing seen yet."""
        self._limit, self._allowance = limit, allowance
        self._seen, self._count, self._mean, self._squares = 0, 0, 0.0, 0.0
        self.upper = self.lower = 0.0
        self.crossed: int | None = None
        """Number of the value (from 0) with which a limit was crossed."""

    @property
    def learning(self) -> bool:
        """Whether nothing can be said yet."""
        return self._count < _FIRST

    def add(self, value: float) -> None:
        """Take the next value in."""
        strange = self._count >= _FIRST - 1 and abs(self._judge(value)) > _STRANGE
        self._seen += 1
        if strange:  # or the first of a new mean would widen what the next are judged by
            return
        before, self._count = self._mean, self._count + 1
        self._mean += (value - before) / self._count
        self._squares += (value - before) * (value - self._mean)

    def _judge(self, value: float) -> float:
        """Its score, which the sums have taken."""
        n = self._count
        deviation = math.sqrt(self._squares / (n - 1))
        if deviation == 0.0:
            score = 0.0 if value == self._mean else math.copysign(_LARGEST, value - self._mean)
        else:
            student = math.sqrt(n / (n + 1)) * (value - self._mean) / deviation
            # by its tail: of 1 nothing is left beyond eight deviations
            score = math.copysign(min(float(norm.isf(t.sf(abs(student), n - 1))), _LARGEST), student)
        self.upper = max(0.0, self.upper + score - self._allowance)
        self.lower = max(0.0, self.lower - score - self._allowance)
        if self.crossed is None and max(self.upper, self.lower) > self._limit:
            self.crossed = self._seen
        return score


def change_point(values: Sequence[float]) -> int:
    """Number of the first of `values` after a change of their mean: where it is most likely, if they have one."""
    x = np.asarray(values, dtype=float)
    n = np.arange(1, len(x))
    before, after = np.cumsum(x)[:-1] / n, (x.sum() - np.cumsum(x)[:-1]) / (len(x) - n)
    return int(np.argmax(n * (len(x) - n) * (after - before) ** 2)) + 1
