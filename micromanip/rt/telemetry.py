"""One row per cycle: what was measured, estimated, decided and written, for every axis."""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.estimator import output
from micromanip.rt.laws.sensor import is_on

from .digital_io import asks_feed_hold, is_enabled
from .figures import path_error
from .jit import compiled
from .record import MAX_AXES, Record, record
from .states import STAGE

AXIS_ROW = record(
    ("reference_um", "f8"),
    ("deviation_um", "f8"),
    ("strain_um", "f8"),
    ("stage_um", "f8"),
    ("estimate_um", "f8"),
    ("innovation_um", "f8"),
    ("setpoint_um", "f8"),
    ("feedforward_V", "f8"),
    ("feedback_V", "f8"),
    ("voltage_V", "f8"),
    ("true_strain_um", "f8"),
    ("true_stage_um", "f8"),
    ("path_error_um", "f8"),
    ("uncompensated_um", "f8"),
    ("notch_um", "f8"),
    ("conditions", "i8"),
    ("strain_age_ns", "i4"),
    ("stage_age_ns", "i4"),
    ("deviation_age_ns", "i4"),
    ("fresh", "i4"),
)
ROW = record(
    ("cycle", "i8"),
    ("time_ns", "i8"),
    ("lateness_ns", "i8"),
    ("compute_ns", "i8"),
    ("periods", "i4"),
    ("state", "i4"),
    ("fault", "i4"),
    ("version", "i4"),
    ("phase", "i4"),
    ("lines", "i4"),
    ("axis", AXIS_ROW, (MAX_AXES,)),
)
"""One cycle of telemetry; ``compute_ns`` is the time of the cycle before, ``fresh`` bit 0 strain, 1 stage, 2 deviation;
what an axis does not have is NaN. ``notch_um`` is what the notch took from the PID's error, ``conditions`` has one bit
per code of ``states`` that is raised. ``lines``: bit 0 enable, 1 interlock, 2 retracted, 3 amplifier enable, 4 hold."""


@compiled
def _value(signals: Any, index: int) -> float:
    return signals[index]["value"] if index >= 0 else math.nan


@compiled
def _age(sensor: Record, index: int) -> int:
    return min(sensor["age_ns"], 2_000_000_000) if index >= 0 else -1


@compiled
def _axis_row(p: Record, a: Record, signals: Any, row: Record) -> None:
    stage = p["mode"] == STAGE
    row["reference_um"] = a["reference"]["w"][0] + a["reference"]["w"][3]
    row["conditions"] = a["watch"]["raised"]
    row["deviation_um"] = a["deviation"]["value"] if p["deviation"] >= 0 else math.nan
    row["strain_um"] = a["strain"]["value"]
    row["stage_um"] = a["stage"]["value"] if p["stage"] >= 0 else math.nan
    row["estimate_um"] = output(p["outer"], a["estimator"]["x"]) if stage else math.nan
    row["innovation_um"] = a["estimator"]["innovation_um"] if stage else math.nan
    row["setpoint_um"] = a["setpoint_um"]
    row["feedforward_V"] = a["hysteresis"]["output_V"]
    row["feedback_V"] = a["pid"]["output_V"]
    row["voltage_V"] = a["voltage_V"]
    row["true_strain_um"] = _value(signals, p["true_strain"])
    row["true_stage_um"] = _value(signals, p["true_stage"])
    row["path_error_um"], row["uncompensated_um"] = path_error(p, a, signals)
    row["notch_um"] = a["pid"]["notch_um"]
    row["strain_age_ns"] = _age(a["strain"], p["strain"])
    row["stage_age_ns"] = _age(a["stage"], p["stage"])
    row["deviation_age_ns"] = _age(a["deviation"], p["deviation"])
    row["fresh"] = a["strain"]["fresh"] + 2 * a["stage"]["fresh"] + 4 * a["deviation"]["fresh"]


@compiled
def _lines(p: Record, s: Record) -> int:
    lines = 1 if is_on(p["enable"], s["enable"]) else 0
    lines |= 2 if is_on(p["interlock"], s["interlock"]) else 0
    lines |= 4 if is_on(p["retracted"], s["retracted"]) else 0
    lines |= 8 if is_enabled(s) else 0
    return lines | (16 if asks_feed_hold(s) else 0)


@compiled
def write_row(
    p: Record, s: Record, signals: Any, row: Record, now_ns: int, lateness_ns: int, compute_ns: int, periods: int
) -> None:
    """Fill telemetry `row` with the cycle that has just been run."""
    row["cycle"] = s["cycle"]
    row["time_ns"] = now_ns
    row["lateness_ns"] = lateness_ns
    row["compute_ns"] = compute_ns
    row["periods"] = periods
    row["state"] = s["state"]
    row["fault"] = s["fault"]
    row["version"] = s["version"]
    row["phase"] = s["phase"]
    row["lines"] = _lines(p, s)
    for i in range(p["axes"]):
        _axis_row(p["axis"][i], s["axis"][i], signals, row["axis"][i])
