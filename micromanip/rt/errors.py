"""Errors of an axis: a sample is compared with the set-point, and the reference, of its own time.

A bus delays samples and outputs. Compared with the present set-point, every moving set-point would cause an error of
speed times delay, which the PID would correct by a lead. So the axis stores its set-points of the last cycles. The
configured delay of the output (``answer_cycles``) and the lags of actuator and gauge (``awaited_cycles``, not whole
cycles) count too: a gauge shows the set-point whose voltage has arrived. Without them, a fresh sample of this cycle is
compared with the present set-point.

A known reference is followed ahead by the lag of the actuator (``preview_s``), so that the position is where the
reference is now. Both times change gently (``ease_times``): a moving set-point must not jump with them.

There is one error of each kind per cycle (``measure_errors``): what the PID acts on, what is watched and what is scored
is the same number. The figures of merit are sums over it.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.estimator import INPUT_HISTORY
from micromanip.rt.laws.predictor import position
from micromanip.rt.laws.saturation import attainable, hold_back, slewed

from .jit import compiled
from .record import Record, record
from .states import STAGE

_MASK = INPUT_HISTORY - 1
_GENTLY = 0.01
"""Share of the time that passes by which what is ahead, or awaited, may change."""

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
def move_setpoint(p: Record, s: Record, behind: int, demand_um: float) -> bool:
    """Set-point inside the attainable range and the slew limit; False, and unmoved, if not finite.

    Where its device is behind it goes no further.
    Where it starts outside the range (an actuator at rest) it stays until the demand leads it in: no jump.
    """
    if not math.isfinite(demand_um):
        return False
    step, before_um = p["setpoint_slew_um"], s["setpoint_um"]
    inside_um = attainable(p["setpoint_low_um"], p["setpoint_high_um"], before_um, demand_um)
    s["setpoint_um"] = hold_back(behind, before_um, max(before_um - step, min(before_um + step, inside_um)))
    return True


@compiled
def start_history(p: Record, s: Record) -> None:
    """The axis has rested where its set-point is now, as far as its memory goes; its times are those of `p`."""
    s["preview_s"], s["awaited_cycles"] = p["preview_s"], p["awaited_cycles"]
    for k in range(INPUT_HISTORY):
        s["setpoints"][k] = s["setpoint_um"]
        s["references"][k] = position(s["reference"]["w"])


@compiled
def remember_setpoint(s: Record, cycle: int) -> None:
    """Note set-point and reference of `cycle`; in cycles that were skipped they were those before them."""
    last = s["wanted_cycle"]
    for skipped in range(max(last + 1, cycle - INPUT_HISTORY), cycle):
        s["setpoints"][skipped & _MASK] = s["setpoints"][last & _MASK]
        s["references"][skipped & _MASK] = s["references"][last & _MASK]
    s["setpoints"][cycle & _MASK] = s["setpoint_um"]
    s["references"][cycle & _MASK] = position(s["reference"]["w"])
    s["wanted_cycle"] = cycle


@compiled
def ease_times(p: Record, s: Record) -> None:
    """Move the times in force to those of the parameters; the set-point is slightly faster or slower until then."""
    if s["preview_s"] == p["preview_s"] and s["awaited_cycles"] == p["awaited_cycles"]:
        return
    period_s = 1e-9 / p["cycles_per_ns"]
    s["preview_s"] = slewed(s["preview_s"], p["preview_s"], _GENTLY * period_s)
    s["awaited_cycles"] = slewed(s["awaited_cycles"], p["awaited_cycles"], _GENTLY)


@compiled
def _place(s: Record, cycle: int) -> int:
    """Place of `cycle`, or of the nearest one that is remembered."""
    return max(s["wanted_cycle"] - _MASK, min(s["wanted_cycle"], cycle)) & _MASK


@compiled
def strain_error(p: Record, s: Record, cycle: int) -> float:
    """Set-point less gauge (um), by the newest sample of the gauge as it stands in `cycle`."""
    wanted = cycle - int(s["strain"]["age_ns"] * p["cycles_per_ns"] + 0.5) - p["answer_cycles"]
    setpoint_um = s["setpoints"][_place(s, wanted)]
    if s["awaited_cycles"] > 0.0:
        whole = int(s["awaited_cycles"])
        setpoint_um = s["setpoints"][_place(s, wanted - whole)]
        before_um = s["setpoints"][_place(s, wanted - whole - 1)]
        setpoint_um += (s["awaited_cycles"] - whole) * (before_um - setpoint_um)
    return setpoint_um - s["strain"]["value"]


@compiled
def stage_error(p: Record, s: Record, cycle: int) -> tuple[float, float]:
    """Reference less stage (um), by the newest sample of the stage as it stands in `cycle`; and that reference."""
    taken = cycle - int(s["stage"]["age_ns"] * p["cycles_per_ns"] + 0.5)
    reference_um = s["references"][_place(s, taken)]
    return reference_um - s["stage"]["value"], reference_um


@compiled
def measure_errors(p: Record, s: Record, cycle: int) -> None:
    """Compute the errors of `cycle`, once its set-point is remembered: ``strain_error_um``, ``stage_error_um``.

    ``path_um`` is the reference that the stage is compared with; ``error_fresh`` says that the gauge's sample is new.
    """
    s["strain_error_um"] = strain_error(p, s, cycle)
    s["stage_error_um"], s["path_um"] = stage_error(p, s, cycle)
    s["error_fresh"] = s["strain"]["fresh"]


@compiled
def following_error(p: Record, a: Record) -> float:
    """How far (um) the stage was from the reference, or the gauge from the set-point, by the newest sample."""
    return a["stage_error_um"] if p["mode"] == STAGE else a["strain_error_um"]


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
def mean_squares(step: float, p: Record, a: Record, figures: Record) -> None:
    """Carry the figures of merit of an axis on, by a share `step` of what this cycle adds."""
    error_um = following_error(p, a)
    added_V = a["voltage_V"] - a["hysteresis"]["output_V"]
    figures["error"] += step * (error_um * error_um - figures["error"])
    figures["innovation"] += step * (a["estimator"]["innovation_um"] ** 2 - figures["innovation"])
    figures["feedback"] += step * (added_V * added_V - figures["feedback"])
