"""Whether a recording is good enough to build on: coverage, saturation, and what the model says of unseen data."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.settings.schema.hysteresis import Range

COVERAGE, HELD_OUT_PERCENT, STAGE_FIT_PERCENT, COHERENCE = 0.6, 2.0, 80.0, 0.8
_BINS, _FLAT = 12, 0.35
_PIECE, _OVERLAP, _POINTS = 0.03, 4, 20
"""Of the voltage that a triangle covers, a piece's share; pieces over a point; samples that a slope takes."""


@dataclass(frozen=True)
class Quality:
    """`coverage` of the set-point's range by the record; `flattest` slope in terms of the median one."""

    coverage: float
    flattest: float


def judge_coverage(axis: str, voltage_V: Array, strain_um: Array, setpoint_um: Range) -> Quality:
    """Verdict on a hysteresis record; CheckFailed where no model for the whole set-point's range can come of it."""
    low, high = setpoint_um
    covered = min(high, float(strain_um.max())) - max(low, float(strain_um.min()))
    coverage = covered / (high - low)
    flattest, where_V = _flattest(voltage_V, strain_um)
    if flattest < _FLAT:
        raise CheckFailed(
            f"axis {axis}: near {where_V:.0f} V the gauge follows the voltage with {100 * flattest:.0f} % of its usual "
            f"slope, {100 * _FLAT:.0f} % are needed: the amplifier saturates there or does not keep up, or the stage "
            "meets a stop; correct range_V or slew_V_per_ms of the output, or the supply"
        )
    if coverage < COVERAGE:
        raise CheckFailed(
            f"axis {axis}: the record reaches {strain_um.min():.0f} to {strain_um.max():.0f} um, {100 * coverage:.0f} "
            f"% of the set-point's range {low:g} to {high:g} um; at least {100 * COVERAGE:.0f} % are needed: narrow "
            "setpoint.range_um, or look why the stroke is short: a stop, or an output whose slew_V_per_ms is low"
        )
    return Quality(coverage, flattest)


def steepest_branch(voltage_V: Array, strain_um: Array, setpoint_um: Range) -> float:
    """Steepest slope (um/V) of a slow triangle within the set-points, over pieces of a way up or down; 0: none."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(voltage_V)), prepend=0.0))
    piece_V, steepest = _PIECE * float(np.ptp(voltage_V)), 0.0
    for way in np.split(np.arange(len(voltage_V)), turns + 1):
        if piece_V == 0.0 or len(way) == 0 or np.ptp(voltage_V[way]) < piece_V:
            continue
        size = int(len(way) * piece_V / np.ptp(voltage_V[way]))
        for first in range(0, len(way) - size + 1, max(1, size // _OVERLAP)):
            part = way[first : first + size]
            moved = strain_um[part]
            if size > _POINTS and setpoint_um[0] <= moved.mean() <= setpoint_um[1]:
                # a straight line would average what is steep within the piece: 3 to 17 % were missing
                from_middle_V = voltage_V[part] - voltage_V[part].mean()
                steepest = max(steepest, float(np.polyfit(from_middle_V, moved, 3)[-2]))
    return steepest


def _flattest(voltage_V: Array, strain_um: Array) -> tuple[float, float]:
    """Least slope over the voltage, in terms of the median one, and where."""
    edges = np.linspace(voltage_V.min(), voltage_V.max(), _BINS + 1)
    slopes, centres = [], []
    for low, high in itertools.pairwise(edges):
        inside = (voltage_V >= low) & (voltage_V <= high)
        if np.count_nonzero(inside) > 20 and np.ptp(voltage_V[inside]) > 0:
            slopes.append(float(np.polyfit(voltage_V[inside], strain_um[inside], 1)[0]))
            centres.append(0.5 * (low + high))
    middle = float(np.median(slopes))
    i = int(np.argmin(slopes))
    return slopes[i] / middle, centres[i]
