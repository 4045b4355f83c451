"""A family of models to be fitted: shaping, weights, creep and rate dependence; value and Jacobian.

Parameters in one vector: shaping, log beta, weights, creep gains, log kappa, start. Thresholds are ``r_i = beta i``.
Weights are either ``gamma exp(-delta r_i)`` (log gamma, root of delta) or free, as logarithms of the partial
sums ``alpha + rho_1 + .. + rho_i``: positive partial sums are what makes the inverse exist. Start is where all plays
were before the record, as the distance (um) from the shaping's offset, so that nothing depends on the sensor's zero.

Shaping functions as they are fitted: well-conditioned parameters, value and derivatives.

The tanh shaping's own c3..c6 are nearly unidentifiable (c3 large, c4 small); fitted are its slope and
value at the middle of the record, its half range and its position, and c3..c6 computed from them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from micromanip.control.system import Array
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range

from .kernel import lag_columns, respond

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


class Shaping(ABC):
    """One family of shaping functions over the voltages of a record; parameter `offset` is added to every value."""

    name: str
    count: int
    offset: int

    def __init__(self, v: Array) -> None:
        self.middle, self.half = span(v)

    def about_zero(self) -> Self:
        """The same family, with the same parameters, over voltages less their middle."""
        moved = copy(self)
        moved.middle = 0.0
        return moved

    @abstractmethod
    def start(self, scale_um: float, middle_um: float, rng: np.random.Generator, spread: float) -> Array:
        """Parameters to begin with: phi covers about `scale_um` around `middle_um`; random by `spread`."""

    @abstractmethod
    def value(self, x: Array, v: Array) -> tuple[Array, Array]:
        """phi(v) (n,) and its derivatives (n, count)."""

    @abstractmethod
    def settings(self, x: Array) -> dict[str, Any]:
        """The configuration's keys."""


class Affine(Shaping):
    """Equation (15): parameters log slope over the half range, value at the middle."""

    name, count, offset = "affine", 2, 1

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


class Tanh(Shaping):
    """Equation (16): parameters log slope, value at the middle, log half range of the argument, its centre."""

    name, count, offset = "tanh", 4, 1

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


class Table(Shaping):
    """Monotone table with evenly spaced knots: parameters are the log rises between knots, then the first value."""

    name = "table"

    def __init__(self, v: Array, knots: int) -> None:
        super().__init__(v)
        self.count, self.offset = knots, knots - 1

    @property
    def knots(self) -> Array:
        return np.asarray(self.middle + self.half * np.linspace(-1.0, 1.0, self.count))

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


def lag(x: Array, time_constant_s: float, step_s: float) -> Array:
    """First-order lag along the first axis, at rest at its first value; as the loop steps it, one sample late."""
    step = -np.expm1(-step_s / time_constant_s)
    lagged = np.empty(x.shape)
    lag_columns(x.reshape(len(x), -1), step, lagged.reshape(len(x), -1))
    return lagged


@dataclass(frozen=True)
class Structure:
    """What is fitted; `step_s` is the record's sampling interval."""

    shaping: Shaping
    plays: int
    free: bool
    step_s: float
    creep_s: tuple[float, ...] = ()
    rate: bool = False
    smoothness: float = 0.0
    name: str = field(default="")

    @property
    def weight_count(self) -> int:
        """Parameters of the weights."""
        return self.plays if self.free else 2

    def start(self, y: Array, rng: np.random.Generator, spread: float) -> Array:
        """Parameters to begin with for a record of displacements `y` (n,), random by `spread`."""
        stroke, middle = float(np.ptp(y)), float(np.mean(y))
        shape = self.shaping.start(0.6 * stroke, 0.6 * middle, rng, spread)
        beta = np.log(0.3 * stroke / self.plays) + 0.5 * spread * rng.normal()
        if self.free:
            sums = np.log1p(0.9 * np.arange(1, self.plays + 1) / self.plays)
            weights = sums + 0.05 * spread * rng.normal(size=self.plays)
        else:
            weights = np.array([np.log(0.9 / self.plays), 0.2]) + spread * np.array([0.7, 0.1]) * rng.normal(size=2)
        kappa = [np.log(1e-3 * stroke / self.plays)] if self.rate else []
        from_above = spread > 0.0 and rng.random() < 0.5
        begin = [(0.6 if from_above else -0.6) * stroke * (1.0 + 0.3 * spread * rng.normal())]
        return np.concatenate([shape, [beta], weights, np.zeros(len(self.creep_s)), kappa, begin])

    @property
    def _tail(self) -> int:
        """Where creep gains, log kappa and start begin."""
        return self.shaping.count + 1 + self.weight_count

    def shifted(self, x: Array, offset_um: float) -> Array:
        """Parameters of a model whose displacement is that of `x` plus `offset_um`."""
        moved = x.copy()
        r = np.exp(x[self.shaping.count]) * np.arange(1, self.plays + 1)
        rho = self._weights(x[self.shaping.count + 1 : self._tail], r)[0]
        gain = 1.0 + rho.sum() + x[self._tail : self._tail + len(self.creep_s)].sum()
        moved[self.shaping.offset] += offset_um / gain
        return moved

    def _weights(self, x: Array, r: Array) -> tuple[Array, Array, Array]:
        """Rho (plays,), its derivatives by the weights' parameters (plays, count) and by log beta (plays,)."""
        if self.free:
            sums = np.exp(x)
            by = np.diag(sums)
            by[1:] -= np.diag(sums)[:-1]
            return np.diff(np.append(1.0, sums)), by, np.zeros(self.plays)
        gamma, delta = np.exp(x[0]), x[1] ** 2
        rho = gamma * np.exp(-delta * r)
        return rho, np.column_stack([rho, -2.0 * x[1] * r * rho]), -delta * r * rho

    def value(self, x: Array, v: Array) -> tuple[Array, Array]:
        """Displacement (n,) and Jacobian (n, parameters)."""
        at = self.shaping.count
        shape, beta = x[:at], np.exp(x[at])
        weight_x = x[at + 1 : at + 1 + self.weight_count]
        gains = x[at + 1 + self.weight_count : at + 1 + self.weight_count + len(self.creep_s)]
        kappa = float(np.exp(x[-2])) if self.rate else 0.0
        by_offset = np.zeros(self.shaping.count)
        by_offset[self.shaping.offset] = 1.0
        u, du = self.shaping.value(shape, v)
        r = beta * np.arange(1, self.plays + 1)
        rho, by_weight, by_beta = self._weights(weight_x, r)
        start = float(x[self.shaping.offset] + x[-1])
        s = respond(u, du, r, rho, kappa=kappa, step_s=self.step_s, start=start, dstart=by_offset)
        y, by_shape = s.y, s.by_shape
        lags = []
        for gain, time_constant in zip(gains, self.creep_s, strict=True):
            lags.append(lag(u, time_constant, self.step_s))
            y = y + gain * lags[-1]
            by_shape = by_shape + gain * lag(du, time_constant, self.step_s)
        columns = [by_shape, s.by_threshold @ r + s.states @ by_beta, s.states @ by_weight, *lags]
        if self.rate:
            columns.append(kappa * s.by_kappa)
        columns.append(s.by_start)
        return y, np.column_stack(columns)

    def prior(self, scale: float) -> Array:
        """Rows that ask for smooth neighbours, where there is a table or free weights: (rows, parameters)."""
        at, total = self.shaping.count, self._tail + len(self.creep_s) + self.rate + 1
        rows = []
        if self.smoothness > 0.0:
            table = range(at - 2) if self.shaping.name == "table" else range(0)
            free = range(at + 1, at + self.plays) if self.free else range(0)
            for i in (*table, *free):
                row = np.zeros(total)
                row[i], row[i + 1] = -1.0, 1.0
                rows.append(row)
        return self.smoothness * scale * np.array(rows).reshape(-1, total)

    def settings(self, x: Array, range_um: Range) -> PrandtlIshlinskii:
        """The model as it stands in the configuration."""
        at = self.shaping.count
        r = np.exp(x[at]) * np.arange(1, self.plays + 1)
        rho = self._weights(x[at + 1 : at + 1 + self.weight_count], r)[0]
        first = self._tail
        return PrandtlIshlinskii(
            model="pi",
            **self.shaping.settings(x[:at]),
            thresholds_um=tuple(float(value) for value in r),
            weights=tuple(float(value) for value in rho),
            rate_ms=1e3 * float(np.exp(x[-2])) if self.rate else 0.0,
            creep_s=self.creep_s,
            creep_gains=tuple(float(value) for value in x[first : first + len(self.creep_s)]),
            range_um=range_um,
        )
