"""A learned correction as the loop plays it: one row per cycle, and what the law (``rt/laws/learned.py``) is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.record import MAX_AXES

Array = NDArray[np.float64]

ASIDE = ".before_fault"
"""Ends the name of a memory's file that is kept, and not gone by any more."""
FADE_S = 0.05
"""Soft for the stage's first mode, and short beside a part, which is not corrected in full meanwhile."""
TOLERANCE_UM = 5.0
"""Ten times what a usual tracker scatters about the same path."""
WIRED_SEARCH_S = 0.05
"""The signal says to the cycle when a part begins; machines do not."""
RECOGNISED_S = 0.5
"""So much of a path is looked at to find out where in it a part is."""
_TOLD_S = 1.0
"""What finding out, and telling the loop, may take beyond that."""


@dataclass(frozen=True)
class Played:
    """How a correction may be played: never more than `limit_um`, no further than `tolerance_um` from its path.

    Parts begin to the cycle where `search_s` is 0; else the path says when, at most `search_s` from where it was told.
    """

    limit_um: float
    tolerance_um: float = TOLERANCE_UM
    search_s: float = 0.0
    repeats: bool = False


def rows_to_play(
    values: Mapping[int, tuple[Array, Array]], rate_hz: float, loop_hz: float, *, repeats: bool = False
) -> Array:
    """Corrections and paths (n,) in um by number of the axis, `rate_hz` values a second, as rows (2 k, MAX_AXES).

    k rows of what is played in k cycles, then as many of the path that it belongs to. Where it `repeats` the first
    value comes after the last.
    """
    from scipy.interpolate import CubicSpline

    count = max((len(correction) for correction, _ in values.values()), default=1)
    cycles = max(1, round(count * loop_hz / rate_hz))
    rows = np.zeros((2 * cycles, MAX_AXES))
    for axis, both in values.items():
        for first, each in zip((0, cycles), both, strict=True):
            at = np.arange(cycles) * (rate_hz / loop_hz)
            if repeats:
                curve = CubicSpline(np.arange(len(each) + 1), np.append(each, each[0]), bc_type="periodic")
            else:
                at, curve = np.minimum(at, len(each) - 1.0), CubicSpline(np.arange(len(each)), each)
            rows[first : first + cycles, axis] = curve(at)
    return rows


def fill_learned(p: Any, number: int, axis: int, rows: int, played: Played, loop_hz: float, first: int = 0) -> None:
    """Let the axis' record `p` (of LEARNED_PARAMETERS) play half of `rows` rows; `number` 0: none any more."""
    p["number"], p["rows"], p["column"], p["first"], p["repeats"] = number, rows // 2, axis, first, played.repeats
    p["fade_cycles"] = max(1, round(FADE_S * loop_hz))
    p["search_cycles"] = round(played.search_s * loop_hz)
    waits = played.search_s > 0.0 and not played.repeats
    late_s = played.search_s + RECOGNISED_S + _TOLD_S if waits else 2.0 * FADE_S
    p["latest_cycles"] = round(late_s * loop_hz)
    p["limit_um"], p["tolerance_um"], p["cycles_per_s"] = played.limit_um, played.tolerance_um, loop_hz
