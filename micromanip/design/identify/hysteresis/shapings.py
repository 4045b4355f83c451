"""Shaping functions as they are fitted: well-conditioned parameters, value and derivatives.

The tanh shaping's own c3..c6 are nearly unidentifiable (c3 large, c4 small); fitted are its slope and
value at the middle of the record, its half range and its position, and c3..c6 computed from them.
"""

from __future__ import annotations

from copy import copy
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from .kernel import Array

# A search for the best model takes another way where rounding differs, and may end elsewhere. So that nothing it finds
# depends on where a sensor has its zero, it sees numbers that are the same, to the last bit, wherever that is.

_GRID = 2.0**24


def span(signal: Array) -> tuple[float, float]:
    """Middle and half width of a signal (n,), the width to 24 bits."""
    low, high = float(signal.min()), float(signal.max())
    return 0.5 * (low + high), float(np.float32(0.5 * (high - low)))


def about_zero(signal: Array, middle: float, half: float) -> Array:
    """`signal` (n,) less `middle`, in steps of 2^-24 of `half`."""
    return np.asarray(np.rint((signal - middle) / half * _GRID) / _GRID * half)


_Family = TypeVar("_Family", bound="Shaping")


class Shaping(Protocol):
    """One family of shaping functions over the voltages of a record."""

    name: str
    count: int
    middle: float
    half: float
    offset: int
    """Which parameter is added to every value."""

    def about_zero(self) -> Self:
        """The same family, with the same parameters, over voltages less their middle."""
        ...

    def start(self, scale_um: float, middle_um: float, rng: np.random.Generator, spread: float) -> Array:
        """Parameters to begin with: phi covers about `scale_um` around `middle_um`; random by `spread`."""
        ...

    def value(self, x: Array, v: Array) -> tuple[Array, Array]:
        """phi(v) (n,) and its derivatives (n, count)."""
        ...

    def settings(self, x: Array) -> dict[str, Any]:
        """The configuration's keys."""
        ...


def _about_zero(shaping: _Family) -> _Family:
    moved = copy(shaping)
    moved.middle = 0.0
    return moved


class Affine:
    """Equation (15): parameters log slope over the half range, value at the middle."""

    name, count, offset = "affine", 2, 1

    def __init__(self, v: Array) -> None:
        self.middle, self.half = span(v)

    def about_zero(self) -> Self:
        return _about_zero(self)

    def start(self, scale_um: float, middle_um: float, rng: np.random.Generator, spread: float) -> Array:
        return np.array([np.log(0.5 * scale_um), middle_um]) + spread * np.array([0.3, 0.1 * scale_um]) * rng.normal(
            size=2
        )

    def value(self, x: Array, v: Array) -> tuple[Array, Array]:
        z = np.exp(x[0]) * (v - self.middle) / self.half
        return x[1] + z, np.column_stack([z, np.ones_like(v)])

    def settings(self, x: Array) -> dict[str, Any]:
        slope = float(np.exp(x[0])) / self.half
        return {"shaping": "affine", "coefficients": (slope, float(x[1]) - slope * self.middle)}


class Tanh:
    """Equation (16): parameters log slope, value at the middle, log half range of the argument, its centre."""

    name, count, offset = "tanh", 4, 1

    def __init__(self, v: Array) -> None:
        self.middle, self.half = span(v)

    def about_zero(self) -> Self:
        return _about_zero(self)

    def start(self, scale_um: float, middle_um: float, rng: np.random.Generator, spread: float) -> Array:
        centre = np.array([np.log(0.5 * scale_um), middle_um, np.log(0.5), 0.0])
        return centre + spread * np.array([0.3, 0.1 * scale_um, 1.0, 0.5]) * rng.normal(size=4)

    def value(self, x: Array, v: Array) -> tuple[Array, Array]:
        slope, a, m = np.exp(x[0]), np.exp(np.clip(x[2], -12.0, 6.0)), np.clip(x[3], -6.0, 6.0)
        z = (v - self.middle) / self.half
        t, t_mid = np.tanh(a * z + m), np.tanh(m)
        steep, steep_mid = 1.0 - t * t, 1.0 - t_mid * t_mid
        f = (t - t_mid) / (a * steep_mid)
        by_a = steep * z / steep_mid - f
        by_m = (steep - steep_mid) / (a * steep_mid) + 2.0 * t_mid * f
        return x[1] + slope * f, np.column_stack([slope * f, np.ones_like(v), slope * by_a, slope * by_m])

    def settings(self, x: Array) -> dict[str, Any]:
        slope, a, m = np.exp(x[0]), np.exp(np.clip(x[2], -12.0, 6.0)), np.clip(x[3], -6.0, 6.0)
        c3 = slope / (a * (1.0 - np.tanh(m) ** 2))
        c4 = a / self.half
        coefficients = (c3, c4, m - c4 * self.middle, x[1] - c3 * np.tanh(m))
        return {"shaping": "tanh", "coefficients": tuple(float(c) for c in coefficients)}


class Table:
    """Monotone table with evenly spaced knots: parameters are the log rises between knots, then the first value."""

    name = "table"

    def __init__(self, v: Array, knots: int) -> None:
        self.middle, self.half = span(v)
        self.count, self.offset = knots, knots - 1

    @property
    def knots(self) -> Array:
        return np.asarray(self.middle + self.half * np.linspace(-1.0, 1.0, self.count))

    def about_zero(self) -> Self:
        return _about_zero(self)

    def start(self, scale_um: float, middle_um: float, rng: np.random.Generator, spread: float) -> Array:
        rises = np.full(self.count - 1, np.log(scale_um / (self.count - 1)))
        rises = rises + 0.2 * spread * rng.normal(size=len(rises))
        return np.append(rises, middle_um - 0.5 * scale_um)

    def value(self, x: Array, v: Array) -> tuple[Array, Array]:
        rises = np.exp(x[:-1])
        heights = x[-1] + np.append(0.0, np.cumsum(rises))
        knots = self.knots
        i = np.clip(np.searchsorted(knots, v) - 1, 0, self.count - 2)
        share = (v - knots[i]) / (knots[i + 1] - knots[i])
        by_height = np.zeros((len(v), self.count))
        by_height[np.arange(len(v)), i] = 1.0 - share
        by_height[np.arange(len(v)), i + 1] += share
        by_rise = np.cumsum(by_height[:, ::-1], axis=1)[:, ::-1][:, 1:] * rises
        return by_height @ heights, np.column_stack([by_rise, np.ones_like(v)])

    def settings(self, x: Array) -> dict[str, Any]:
        heights = x[-1] + np.append(0.0, np.cumsum(np.exp(x[:-1])))
        return {
            "shaping": "table",
            "table_V": tuple(float(value) for value in self.knots),
            "table_um": tuple(float(value) for value in heights),
        }
