"""Offset v0 and gain N of the inverse over amplitude (figure 7), and over amplitude and offset as a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range

from .operator import Array, Operator, inverse_operator
from .quadrature import harmonics

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Sweep:
    """Over amplitudes (k,) in um about ``offset_um``: ``v0_V`` (k,), ``gain_V_per_um`` (k,), headroom (k,)."""

    offset_um: float
    amplitude_um: Array
    v0_V: Array
    gain_V_per_um: Complex
    headroom: Array


@dataclass(frozen=True)
class GainMap:
    """``gain_V_per_um`` (offsets, amplitudes); nan where the sine leaves the set-point's range or has no inverse."""

    offset_um: Array
    amplitude_um: Array
    gain_V_per_um: Complex
    headroom: Array


def sweep(model: PrandtlIshlinskii, offset_um: float, amplitude_um: Array) -> Sweep:
    """Describing function of the inverse of `model` over amplitudes (k,) about one offset."""
    operator = inverse_operator(model)
    return _row(operator, offset_um, np.asarray(amplitude_um, dtype=float))


def _row(operator: Operator, offset_um: float, amplitude_um: Array) -> Sweep:
    found = [harmonics(operator, float(a), offset_um) for a in amplitude_um]
    return Sweep(
        offset_um,
        amplitude_um,
        np.array([h.v0 for h in found]),
        np.array([h.gain for h in found]),
        np.array([h.headroom for h in found]),
    )


def amplitudes_up_to(largest_um: float, thresholds: Array, count: int) -> Array:
    """About `count` even amplitudes up to `largest_um`, and those at and beside every threshold below it."""
    even = np.linspace(largest_um / count, largest_um, count)
    near = np.concatenate([thresholds * factor for factor in (1.0 - 1e-3, 1.0, 1.0 + 1e-3)])
    return np.unique(np.concatenate([even, near[(near > 0) & (near < largest_um)]]))


def gain_map(model: PrandtlIshlinskii, range_um: Range, offsets: int = 41, amplitudes: int = 40) -> GainMap:
    """Map over the offsets and amplitudes whose sines stay inside `range_um`."""
    low, high = range_um
    operator = inverse_operator(model)
    half = 0.5 * (high - low)
    offset = np.linspace(low, high, offsets)
    amplitude = np.linspace(half / amplitudes, half, amplitudes)
    gain = np.full((offsets, amplitudes), complex(np.nan, np.nan))
    headroom = np.full((offsets, amplitudes), np.nan)
    for i, centre in enumerate(offset):
        inside = amplitude <= min(centre - low, high - centre) + 1e-9 * half
        if inside.any():
            row = _row(operator, float(centre), amplitude[inside])
            gain[i, inside], headroom[i, inside] = row.gain_V_per_um, row.headroom
    return GainMap(offset, amplitude, gain, headroom)


def branch_slopes(model: PrandtlIshlinskii, range_um: Range, points: int = 401) -> tuple[float, float]:
    """The flattest and the steepest slope (um/V) of the model on its way through `range_um`, up and down.

    A describing function averages over a swing: while a set-point moves one way, a small signal on it meets the branch.
    """
    operator, way = inverse_operator(model), np.linspace(*range_um, points)
    there_and_back = np.concatenate([way, way[-2:0:-1]])
    w, total = np.zeros(len(operator.thresholds)), np.zeros(2 * len(there_and_back) + 1)
    path_um = np.concatenate([there_and_back, there_and_back, way[:1]])
    for k, u in enumerate(path_um):
        w = np.maximum(u - operator.thresholds, np.minimum(u + operator.thresholds, w))
        total[k] = operator.gain * u + w @ operator.weights
    settled = slice(len(there_and_back), None)  # the first round begins at rest
    slopes = np.diff(path_um[settled]) / np.diff(operator.after(total[settled]))
    slopes = slopes[np.isfinite(slopes) & (slopes > 0.0)]  # beyond its range an inverse has none
    return float(slopes.min(initial=np.inf)), float(slopes.max(initial=0.0))
