"""Figures of merit: the path error of a run, and mean squares by which tunings are compared."""

from __future__ import annotations

import math
from typing import Any

from .jit import compiled
from .record import Record, record
from .states import STAGE
from .watch import following_error

FIGURES = record(("error", "f8"), ("innovation", "f8"), ("feedback", "f8"))
"""Mean squares over about a second: error (um^2), innovation (um^2), and what the PID adds to the feedforward (V^2)."""


@compiled
def score(a: Record, path_error_um: float, uncompensated_um: float) -> None:
    """Add one cycle to the running figures of the path error."""
    a["errors"] += 1
    a["error_squares"] += path_error_um * path_error_um
    a["error_max"] = max(a["error_max"], abs(path_error_um))
    a["uncompensated_squares"] += uncompensated_um * uncompensated_um


@compiled
def path_error(p: Record, a: Record, signals: Any) -> tuple[float, float]:
    """Error at the spindle with and without compensation: the simulation's truth, else as the newest sample says."""
    if p["path_error"] >= 0:
        return signals[p["path_error"]]["value"], signals[p["uncompensated"]]["value"]
    if p["mode"] == STAGE:
        return a["stage_error_um"], a["path_um"]
    return math.nan, math.nan


@compiled
def mean_squares(p: Record, axis: Record, a: Record) -> None:
    """Carry the figures of merit of an axis on."""
    figures = a["figures"]
    error_um = following_error(axis, a)
    added_V = a["voltage_V"] - a["hysteresis"]["output_V"]
    step = p["figures_step"]
    figures["error"] += step * (error_um * error_um - figures["error"])
    figures["innovation"] += step * (a["estimator"]["innovation_um"] ** 2 - figures["innovation"])
    figures["feedback"] += step * (added_V * added_V - figures["feedback"])
