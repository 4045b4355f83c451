"""What a second, narrow predictor should know: the roughness of the slow path where its oscillations stay as they are.

Beside walks that bear another pose part of the path is taken for an oscillation that changes, and the jerk that is
likeliest is that of both. The narrow predictor (``rt/laws/steady.py``) has walks of its own, so jerk and the slow
frequency at which the path returns are those that leave least of the innovations beside these (``innovations.py``: the
maximum of their likelihood), all else being as it was fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.control.joints import joints_radius
from micromanip.settings.schema.reference import AxisTracker, Steady

from .innovations import Whitening

Array = NDArray[np.float64]

_BEGUN_Hz, _LOWEST_Hz, _HIGHEST_SHARE = 0.3, 0.02, 0.25
"""Slow frequency at which the search begins; the lowest one, by which no path returns within a record; no higher than
this share of the slowest oscillation's, which would take part of it over."""
_CALMEST = 1e-3
"""Least jerk, in terms of that of the wide predictor."""


def steady_of(model: AxisTracker, samples: Array) -> Steady | None:
    """What is likeliest of evenly spaced `samples` (n,) beside `model`, their own; None where there is nothing to gain.

    That is so without oscillations, and where the narrow predictor would not bear the ranges of their frequencies.
    """
    if not model.oscillations:
        return None
    highest = _HIGHEST_SHARE * min(each.frequency_Hz for each in model.oscillations)
    low = np.log([_CALMEST * model.jerk_um_per_s3, _LOWEST_Hz])
    high = np.log([model.jerk_um_per_s3, max(highest, 2.0 * _LOWEST_Hz)])

    def described(x: Array) -> Steady:
        return Steady(jerk_um_per_s3=float(np.exp(x[0])), returns_Hz=float(np.exp(x[1])))

    def left(x: Array) -> Array:
        sure = replace(model, steady=described(x)).sure
        assert sure is not None
        return Whitening.of(sure).innovations(samples) / model.noise_um

    start = np.log([0.5 * model.jerk_um_per_s3, min(_BEGUN_Hz, highest)])
    start = np.clip(start, low + 1e-6, high - 1e-6)
    found = least_squares(left, start, bounds=(low, high), ftol=1e-6, xtol=1e-4, max_nfev=30)
    steady = described(np.asarray(found.x))
    sure = replace(model, steady=steady).sure
    return steady if sure is not None and joints_radius(sure) < 1.0 else None
