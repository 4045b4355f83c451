"""The figures that the loop gathers of the tuning in force, of the candidate beside it, and of a trial."""

from __future__ import annotations

import math
from typing import Any

from micromanip.replies import Comparison, TrialError, TuningFigures
from micromanip.rt.states import STAGE, VOLTAGE


def comparison(status: Any, parameters: Any, axes: list[str]) -> dict[str, Comparison]:
    """Figures of both tunings by axis, of those that are controlled; `parameters` (1,) are the candidate's."""
    active, candidate = status["state"][0]["axis"], status["shadow"][0]["axis"]
    return {
        name: Comparison(active=_figures(active[i], mode), candidate=_figures(candidate[i], mode))
        for i, name in enumerate(axes)
        if (mode := int(parameters[0]["axis"][i]["mode"])) != VOLTAGE
    }


def trial(status: Any, parameters: Any, axes: list[str]) -> dict[str, TrialError]:
    """Errors of the trial of `parameters` (1,) by axis, of those that are controlled."""
    state, p = status["state"][0], parameters[0]
    found = {}
    for i, name in enumerate(axes):
        if p["axis"][i]["mode"] != VOLTAGE:
            before = math.sqrt(state["trial_before"][i])
            limit = float(p["trial_factor"]) * before + float(p["trial_floor"])
            found[name] = TrialError(
                before_um=_rounded(before), now_um=_root(state["trial_now"][i]), limit_um=_rounded(limit)
            )
    return found


def passed_s(status: Any, parameters: Any) -> float:
    """How long (s) the trial has gone on, or went on."""
    return max(0, int(status["state"][0]["trial_cycles"])) * int(parameters[0]["period_ns"]) * 1e-9


def trial_s(parameters: Any) -> float:
    """How long (s) a trial of `parameters` (1,) is."""
    return int(parameters[0]["trial_cycles"]) * int(parameters[0]["period_ns"]) * 1e-9


def _figures(axis: Any, mode: int) -> TuningFigures:
    figures = axis["figures"]
    innovation_um = _root(figures["innovation"]) if mode == STAGE else None
    return TuningFigures(innovation_um=innovation_um, feedback_V=_root(figures["feedback"]))


def _root(square: Any) -> float | None:
    return _rounded(math.sqrt(square))


def _rounded(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
