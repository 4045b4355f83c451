"""Whether a run holds the path of a memory, and when it begins there: by the path that the tracker saw itself."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from micromanip.errors import CheckFailed

from .memory import Memory
from .part import Run
from .zero_phase import filtered, low_pass

Array = NDArray[np.float64]

_SEEN_HZ = 20.0
"""Up to where paths are compared: beyond that the tracker's noise is larger than a robot's motion."""
_SHARE, _LEAST_UM = 0.01, 0.5
"""Of the path's rms that it may differ, and what it always may: rms, beyond the noise of the tracker."""


def found_at(memory: Memory, run: Run, about_s: float, search_s: float, tolerance_um: float | None = None) -> float:
    """When the memory's path begins in `run`, at most `search_s` from `about_s`; s after tracking has begun.

    Raises CheckFailed where it differs by more than `tolerance_um` rms (None: 1 % of its own, .5 um at least).
    """
    values, rate_hz = len(memory.path_um), memory.rate_hz
    first_s = max(0.0, about_s - search_s)
    places = int((about_s + search_s - first_s) * rate_hz) + 1
    last_s = run.taken_s[-1]
    count = min(values + places - 1, int((last_s - first_s) * rate_hz) + 1)
    if count < values:
        raise CheckFailed(
            f"{run.what}: it tracks for {run.time_s[-1]:.2f} s under one tuning, the part of {memory.seconds:g} s "
            f"begins at about {about_s:g} s: the part was not finished, nothing is learned from it"
        )
    seen, known = (
        filtered(path, rate_hz, partial(low_pass, corner_hz=_SEEN_HZ))
        for path in (run.path(first_s + np.arange(count) / rate_hz), memory.path_um)
    )
    middle = float(known.mean())
    apart = _apart(seen - middle, known - middle)
    best = int(np.argmin(apart))
    allowed_um = max(_LEAST_UM, _SHARE * float(np.std(known))) if tolerance_um is None else tolerance_um
    differs_um = float(np.sqrt(max(0.0, apart[best])))
    if differs_um > allowed_um:
        raise CheckFailed(
            f"{run.what}: axis {memory.axis} follows another path than its memory's ({memory.path}): at best they "
            f"differ by {differs_um:.3g} um rms, at most {allowed_um:.3g} um may be"
        )
    return first_s + (best + _between(apart, best)) / rate_hz


def _apart(seen: Array, known: Array) -> Array:
    """Mean square (places,) of the difference between `known` (n,) and each n values in a row of `seen`."""
    squares = np.concatenate([np.zeros(1), np.cumsum(seen**2)])
    own = squares[len(known) :] - squares[: -len(known)]
    return np.asarray((own - 2.0 * fftconvolve(seen, known[::-1], "valid") + np.sum(known**2)) / len(known))


def _between(apart: Array, best: int) -> float:
    """By how much of a value the least of a parabola through three neighbours lies beside the middle one."""
    if not 0 < best < len(apart) - 1:
        return 0.0
    before, least, after = apart[best - 1 : best + 2]
    bend = before - 2.0 * least + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend > 0.0 else 0.0
