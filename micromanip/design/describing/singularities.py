"""Where the inverse is singular: where it does not exist, and where its describing function jumps or blows up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range, attainable_um

from .operator import Operator, inverse_operator
from .quadrature import harmonics
from .sweep import GainMap

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
