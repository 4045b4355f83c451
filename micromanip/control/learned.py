"""A learned correction as the loop plays it: one row per cycle, and what the law (``rt/laws/learned.py``) is told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.record import MAX_AXES

Array = NDArray[np.float64]

FADE_S = 0.05
"""Soft for the stage's first mode, and short beside a part, which is not corrected in full meanwhile."""


def rows_to_play(corrections: Mapping[int, Array], rate_hz: float, loop_hz: float) -> Array:
    """Corrections (n,) in um by number of the axis, `rate_hz` values a second, as rows (cycles, MAX_AXES)."""
    from scipy.interpolate import CubicSpline

    values = max((len(correction) for correction in corrections.values()), default=1)
    cycles = max(1, round(values * loop_hz / rate_hz))
    rows = np.zeros((cycles, MAX_AXES))
    for axis, correction in corrections.items():
        at = np.minimum(np.arange(cycles) * (rate_hz / loop_hz), len(correction) - 1.0)
        rows[:, axis] = CubicSpline(np.arange(len(correction)), correction)(at)
    return rows


def fill_learned(p: Any, number: int, axis: int, rows: int, limit_um: float, loop_hz: float) -> None:
    """Let the axis' record `p` (of LEARNED_PARAMETERS) play `rows` rows, from the cycle that it is put in force in."""
    p["number"], p["rows"], p["column"] = number, rows, axis
    p["fade_cycles"] = max(1, round(FADE_S * loop_hz))
    p["limit_um"], p["cycles_per_s"] = limit_um, loop_hz
