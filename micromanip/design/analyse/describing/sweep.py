"""Offset v0 and gain N of the inverse over amplitude (figure 7), over amplitude and offset as a map; its verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range, attainable_um

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


STEEP = 5.0
"""A gain this many times the median of the map counts as blowing up."""
JUMP = 1e-3
"""A relative change of N that does not vanish between ever nearer amplitudes counts as a jump."""
_BISECTIONS = 40


@dataclass(frozen=True)
class Verdict:
    """``problems`` in words, none where the inverse is regular over the whole range; and the figures behind them."""

    attainable_um: Range
    gain_range_V_per_um: Range
    jump: float
    problems: tuple[str, ...]


def judge(model: PrandtlIshlinskii, range_um: Range, gain: GainMap) -> Verdict:
    """Verdict over the set-points `range_um`; `gain` is the map over that range."""
    problems = []
    reach = attainable_um(model)
    if reach[0] > range_um[0] or reach[1] < range_um[1]:
        problems.append(
            f"set-points {range_um[0]:g}..{range_um[1]:g} um go beyond what the shaping can reach, "
            f"{reach[0]:.4g}..{reach[1]:.4g} um"
        )
    size = np.abs(gain.gain_V_per_um)
    tried = np.isfinite(gain.headroom)
    blank = tried & ~np.isfinite(size)
    if blank.any():
        i, j = np.argwhere(blank)[0]
        problems.append(
            f"no inverse for a sine of {gain.amplitude_um[j]:.3g} um about {gain.offset_um[i]:.3g} um: "
            f"the {model.shaping} shaping ends there"
        )
    finite = size[np.isfinite(size)]
    if not len(finite):
        return Verdict(reach, (np.nan, np.nan), np.nan, tuple(problems))
    if finite.max() > STEEP * np.median(finite):
        i, j = np.unravel_index(np.nanargmax(size), size.shape)
        problems.append(
            f"|N| blows up: {finite.max():.3g} V/um at {gain.amplitude_um[j]:.3g} um about {gain.offset_um[i]:.3g} um, "
            f"{finite.max() / np.median(finite):.1f} times its median"
        )
    jump = largest_jump(inverse_operator(model), gain)
    if jump > JUMP:
        problems.append(f"N jumps by {100.0 * jump:.2g} % between neighbouring amplitudes")
    return Verdict(
        reach,
        (float(finite.min()), float(finite.max())),
        jump,
        tuple(problems),
    )


def largest_jump(operator: Operator, gain: GainMap) -> float:
    """Relative change of N that is left where it changes most, once the amplitudes have been bisected together."""
    change = np.abs(np.diff(gain.gain_V_per_um, axis=1))
    if not np.isfinite(change).any():
        return 0.0
    i, j = np.unravel_index(np.nanargmax(change), change.shape)
    centre = float(gain.offset_um[i])
    low, high = float(gain.amplitude_um[j]), float(gain.amplitude_um[j + 1])
    at_low, at_high = (harmonics(operator, a, centre).gain for a in (low, high))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        between = harmonics(operator, middle, centre).gain
        if abs(between - at_low) > abs(at_high - between):
            high, at_high = middle, between
        else:
            low, at_low = middle, between
    return abs(at_high - at_low) / abs(at_low)
