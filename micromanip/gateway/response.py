"""What an axis answered to a move: figures read off its set-point and its position, cycle by cycle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import UsageError
from micromanip.rt.states import STAGE

from .cell import Source
from .views import number

Array = NDArray[np.float64]

_SETTLED = 0.02
_MOST_S = 70.0
_SIGNALS = {STAGE: ("reference_um", "stage_um")}
_OTHERWISE = ("setpoint_um", "strain_um")
"""What is wanted, and what is found, by the mode of the axis."""


def response_of(source: Source, query: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of the cycles `first` to `last` of `axis`; of a step of `by_um`, or a sine of `frequency_Hz`, its own.

    Raises UsageError where there is no such axis, or these cycles are not there row by row.
    """
    axes = source.about["axes"]
    if query.get("axis") not in axes:
        raise UsageError(f"there is no axis {query.get('axis')!r:.40}; there are {', '.join(axes)}")
    index, period_s = axes.index(query["axis"]), source.about["period_ns"] * 1e-9
    first, last = (round(number(query, name, 0, 2**53)) for name in ("first", "last"))
    rows = source.history.rows(first, min(last, first + round(_MOST_S / period_s)))
    if len(rows) < 2:
        raise UsageError("these cycles are not there row by row")
    wanted_name, found_name = signals_of(source, index)
    axis = rows["axis"][:, index]
    t_s = (rows["cycle"] - rows["cycle"][0]) * period_s
    wanted, found = np.asarray(axis[wanted_name], float), np.asarray(axis[found_name], float)
    known = np.isfinite(wanted) & np.isfinite(found)
    figures: dict[str, float | None] = errors(wanted[known], found[known])
    if query.get("by_um") is not None:
        figures |= step_figures(t_s[known], found[known], number(query, "by_um", -1e4, 1e4))
    if query.get("frequency_Hz") is not None:
        figures |= sine_figures(t_s[known], wanted[known], found[known], number(query, "frequency_Hz", 1e-3, 1e4))
    return {"wanted": wanted_name, "found": found_name, "figures": figures}


def signals_of(source: Source, index: int) -> tuple[str, str]:
    """Names of what axis `index` is to follow and of what says where it is."""
    newest = source.parameters[int(np.argmax(source.parameters["version"]))]
    return _SIGNALS.get(int(newest["axis"][index]["mode"]), _OTHERWISE)


def errors(wanted: Array, found: Array) -> dict[str, float | None]:
    """Rms and peak of the difference, um."""
    if not len(wanted):
        return {"error_rms_um": None, "error_peak_um": None}
    difference = wanted - found
    return {
        "error_rms_um": float(np.sqrt(np.mean(difference**2))),
        "error_peak_um": float(np.abs(difference).max()),
    }


def step_figures(t_s: Array, found: Array, by_um: float) -> dict[str, float | None]:
    """Overshoot (%), rise from 10 to 90 % and settling to 2 % (s from the beginning), of a step of `by_um`.

    None where it does not get there. What is there before the step counts as its beginning.
    """
    none: dict[str, float | None] = {"overshoot_percent": None, "rise_s": None, "settling_s": None}
    if len(found) < 2 or by_um == 0.0:
        return none
    share = (found - found[0]) / by_um
    late = np.flatnonzero(np.abs(share - 1.0) > _SETTLED)
    ten, ninety = (int(np.argmax(share >= level)) for level in (0.1, 0.9))
    settles = len(late) == 0 or late[-1] < len(share) - 1
    return {
        "overshoot_percent": max(0.0, 100.0 * float(share.max() - 1.0)),
        "rise_s": float(t_s[ninety] - t_s[ten]) if share[ninety] >= 0.9 else None,
        "settling_s": float(t_s[late[-1] + 1] if len(late) else t_s[0]) if settles else None,
    }


def sine_figures(t_s: Array, wanted: Array, found: Array, frequency_Hz: float) -> dict[str, float | None]:
    """Gain, and lag in degrees, of `found` to `wanted` at `frequency_Hz`, over the middle half."""
    middle = slice(len(t_s) // 4, len(t_s) - len(t_s) // 4)
    if len(t_s[middle]) < 8:
        return {"gain": None, "lag_deg": None}
    turned = np.exp(-2j * np.pi * frequency_Hz * t_s[middle])
    basis = np.stack([turned.real, turned.imag, np.ones(len(turned))], axis=1)
    # signal = Re(c exp(i w t)) + mean
    into, out = (complex(*np.linalg.lstsq(basis, signal[middle], rcond=None)[0][:2]) for signal in (wanted, found))
    if abs(into) < 1e-9:
        return {"gain": None, "lag_deg": None}
    return {"gain": abs(out / into), "lag_deg": -float(np.degrees(np.angle(out / into)))}
