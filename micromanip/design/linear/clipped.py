"""Sensors at the end of their range: a linear model of what they read has poles that the plant has not.

Unlike a hysteresis, a plant with dynamics may turn anywhere, whatever its input does. So it is looked at how an output
comes to its extreme: within bands of it that grow fourfold the samples of a smooth peak double, those of a limit stay.
"""

from __future__ import annotations

import numpy as np

from .modal import Array

_BAND, _WIDER = 0.002, 4.0
"""Of the output's stroke; and how many times that the wider band is."""
_CODE, _CODES = 0.5, 3.5
"""The least of both in steps of a coarse converter."""
_PILED, _FEWEST, _SHARE = 0.7, 8, 0.005
_MOVING = 0.02
"""Mean way of an input, as a share of its stroke, meanwhile: where it rests, as after a step, its output may."""


def clipped(u: Array, y: Array) -> str | None:
    """Which end of its range an output `y` (n,) sticks at while one of the inputs `u` (n, m) moves; None: at none."""
    stroke = float(np.ptp(y))
    steps = np.diff(np.unique(np.round((y - y.min()) / stroke, 9)))
    step = stroke * float(steps.min())
    for end, limit in (("top", y.max()), ("bottom", y.min())):
        away = np.abs(y - limit)
        near = away <= max(_BAND * stroke, _CODE * step)
        wide = away <= max(_WIDER * _BAND * stroke, _CODES * step)
        if near.sum() < max(_FEWEST, _SHARE * len(y)) or near.sum() < _PILED * wide.sum():
            continue
        ways = np.median(np.abs(u[near] - np.median(u[near], axis=0)), axis=0)
        if np.any(ways > _MOVING * np.ptp(u, axis=0)):
            return f"sticks at its {end} value {limit:.6g} for {100.0 * near.mean():.2g} % of the samples"
    return None
