"""Figures of merit: the path error of a run, and mean squares by which tunings are compared."""

from __future__ import annotations

import math
from typing import Any

from .jit import compiled
from .record import Record, record
from .states import STAGE
from .watch import following_error

FIGURES = record(
    ("error", "f8"),
    ("innovation", "f8"),
    ("feedback", "f8"),
    ("errors", "i8"),
    ("error_squares", "f8"),
    ("error_max", "f8"),
    ("uncompensated_squares", "f8"),
)
"""Mean squares over about a second: error (um^2), innovation (um^2), and what the PID adds to the feedforward (V^2);
how many path errors were scored, their sum of squares and largest, and the squares of the deviation itself."""


@compiled
def score(figures: Record, path_error_um: float, uncompensated_um: float) -> None:
    """Add one cycle to the running figures of the path error."""
    figures["errors"] += 1
    figures["error_squares"] += path_error_um * path_error_um
    figures["error_max"] = max(figures["error_max"], abs(path_error_um))
    figures["uncompensated_squares"] += uncompensated_um * uncompensated_um


@compiled
def path_error(p: Record, a: Record, signals: Any) -> tuple[float, float]:
    """Error at the spindle with and without compensation: the simulation's truth, else as the newest sample says."""
    if p["path_error"] >= 0:
        return signals[p["path_error"]]["value"], signals[p["uncompensated"]]["value"]
    if p["mode"] == STAGE:
        return a["stage_error_um"], a["path_um"]
    return math.nan, math.nan


@compiled
def mean_squares(p: Record, axis: Record, a: Record, figures: Record) -> None:
    """Carry the figures of merit of an axis on."""
    error_um = following_error(axis, a)
    added_V = a["voltage_V"] - a["hysteresis"]["output_V"]
    step = p["figures_step"]
    figures["error"] += step * (error_um * error_um - figures["error"])
    figures["innovation"] += step * (a["estimator"]["innovation_um"] ** 2 - figures["innovation"])
    figures["feedback"] += step * (added_V * added_V - figures["feedback"])
