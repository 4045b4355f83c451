"""One row per cycle: what was measured, estimated, decided and written, for every axis."""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.estimator import output
from micromanip.rt.laws.frequency_lock import FOLLOWS, joint_Hz, tooth_Hz
from micromanip.rt.laws.predictor import position
from micromanip.rt.laws.reference import SIGNAL

from .digital_io import asks_feed_hold, is_enabled, is_on
from .errors import path_error
from .jit import compiled
from .record import MAX_AXES, Record, record
from .states import DRIVER_ERROR, STAGE

STRAIN_FRESH, STAGE_FRESH, DEVIATION_FRESH = 1, 2, 4
STRAIN_CAME, STAGE_CAME, DEVIATION_CAME = 8, 16, 32
STRAIN_REPEATED, STAGE_REPEATED = 64, 128
STRAIN_READING, STAGE_READING = 8, 11
AMPLIFIER_OK, TEMPERATURE_OK = 1 << 14, 1 << 15
DEVICE_BELOW, DEVICE_ABOVE = 1 << 16, 1 << 17
"""``fresh``: a good sample; one that came, usable or not; it read as the one before; where three bits begin that say
what a sample that was not usable read; two lines of the amplifier; the device was given less, or more, than the voltage
that was asked for in the cycle before."""
NO_NUMBER, LOW_END, BELOW, SAME, ABOVE, HIGH_END, INFINITE, MINUS_INFINITE = range(8)
"""What it read: at or beyond an end of the range, or beside the last good sample."""
ENABLED, INTERLOCKED, RETRACTED, AMPLIFIER_ON, FEED_HOLD = 1, 2, 4, 8, 16
LINK_DOWN, OUTPUTS_ARE_TAKEN, OUTPUTS_ARE_AWAY, DRIVER_FAILED = 32, 64, 128, 256
PART_RUNS, PART_TURN = 512, 1024
TOOL = 12
"""Bits of ``lines``; the last four of the first nine say how the exchange with the drivers ended. A part is being made;
changes with each part; where the 16 bits of the tool's number begin."""

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
    ("tooth_Hz", "f8"),
    ("joint_1_Hz", "f8"),
    ("joint_2_Hz", "f8"),
    ("joint_3_Hz", "f8"),
    ("learned_um", "f8"),
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
"""One cycle of telemetry; ``compute_ns`` is the time of the cycle before, what an axis does not have is NaN.
``notch_um`` is what the notch took from the PID's error, ``tooth_Hz`` the frequency that the outer loop has found if it
follows the tooth's, else NaN; ``joint_1_Hz`` and so on are those that the predictor's oscillations have found, in the
order of the configuration, NaN where none is followed; ``learned_um`` is what of the reference is a learned correction.
``conditions`` has one bit per code of ``states`` that is raised, ``fresh`` and ``lines`` have the bits above. With the
loop's state before it a row says all that came in: ``micromanip.replay`` runs the cycle again on that."""


@compiled
def _value(signals: Any, index: int) -> float:
    return signals[index]["value"] if index >= 0 else math.nan


@compiled
def _age(sensor: Record, index: int) -> int:
    return min(sensor["age_ns"], 2_000_000_000) if index >= 0 else -1


@compiled
def _reading(sensor: Record, range_um: Any) -> int:
    """Class of an unusable sample's reading."""
    reading, good = sensor["reading"], sensor["value"]
    if not math.isfinite(reading):
        if reading > 0.0:
            return INFINITE
        return MINUS_INFINITE if reading < 0.0 else NO_NUMBER
    if reading >= range_um[1]:
        return HIGH_END
    if reading <= range_um[0]:
        return LOW_END
    if reading == good:
        return SAME
    return ABOVE if reading > good else BELOW


@compiled
def _came(sensor: Record, range_um: Any, now_ns: int, came: int, repeated: int, place: int) -> int:
    """Bits that describe a sensor's sample beside its last good value, enough for a replay."""
    if sensor["arrived_ns"] != now_ns:
        return 0
    bits = came | (repeated if sensor["identical"] > 0 else 0)
    return bits if sensor["fresh"] != 0 else bits | (_reading(sensor, range_um) << place)


@compiled
def _fresh(p: Record, a: Record, behind: int, now_ns: int) -> int:
    bits = a["strain"]["fresh"] + 2 * a["stage"]["fresh"] + 4 * a["deviation"]["fresh"]
    bits |= _came(a["strain"], p["strain_range_um"], now_ns, STRAIN_CAME, STRAIN_REPEATED, STRAIN_READING)
    bits |= _came(a["stage"], p["stage_range_um"], now_ns, STAGE_CAME, STAGE_REPEATED, STAGE_READING)
    bits |= DEVIATION_CAME if a["deviation"]["arrived_ns"] == now_ns else 0
    bits |= AMPLIFIER_OK if is_on(p["amplifier_ok"], a["amplifier_ok"]) else 0
    if behind != 0:
        bits |= DEVICE_BELOW if behind > 0 else DEVICE_ABOVE
    return bits | (TEMPERATURE_OK if is_on(p["temperature_ok"], a["temperature_ok"]) else 0)


@compiled
def _axis_row(p: Record, a: Record, raised: int, behind: int, signals: Any, row: Record, now_ns: int) -> None:
    stage = p["mode"] == STAGE
    row["reference_um"] = position(a["reference"]["w"])
    row["conditions"] = raised
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
    follows = stage and a["estimator"]["given_up"] == FOLLOWS
    row["tooth_Hz"] = tooth_Hz(p["outer"], a["estimator"], p["cycles_per_ns"]) if follows else math.nan
    predicts = p["reference"]["kind"] == SIGNAL and p["reference"]["predict"] != 0
    row["joint_1_Hz"] = joint_Hz(p["reference"], a["reference"], 0) if predicts else math.nan
    row["joint_2_Hz"] = joint_Hz(p["reference"], a["reference"], 1) if predicts else math.nan
    row["joint_3_Hz"] = joint_Hz(p["reference"], a["reference"], 2) if predicts else math.nan
    row["learned_um"] = a["learned"]["played_um"] if a["learned"]["level"] > 0.0 else 0.0
    row["strain_age_ns"] = _age(a["strain"], p["strain"])
    row["stage_age_ns"] = _age(a["stage"], p["stage"])
    row["deviation_age_ns"] = _age(a["deviation"], p["deviation"])
    row["fresh"] = _fresh(p, a, behind, now_ns)


@compiled
def _lines(p: Record, s: Record) -> int:
    lines = ENABLED if is_on(p["enable"], s["enable"]) else 0
    lines |= INTERLOCKED if is_on(p["interlock"], s["interlock"]) else 0
    lines |= RETRACTED if is_on(p["retracted"], s["retracted"]) else 0
    lines |= AMPLIFIER_ON if is_enabled(s) else 0
    lines |= FEED_HOLD if asks_feed_hold(s) else 0
    lines |= LINK_DOWN if s["link_down"] != 0 else 0
    lines |= OUTPUTS_ARE_TAKEN if s["outputs_taken"] != 0 else 0
    lines |= PART_RUNS if s["part"] != 0 else 0
    lines |= PART_TURN if s["parts"] % 2 != 0 else 0
    lines |= s["tool"] << TOOL
    lines |= OUTPUTS_ARE_AWAY if s["outputs_away"] != 0 else 0
    return lines | (DRIVER_FAILED if s["raised"] & (1 << DRIVER_ERROR) != 0 else 0)


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
        raised, behind = s["watch"][i]["raised"], s["order"][i]["behind"]
        _axis_row(p["axis"][i], s["axis"][i], raised, behind, signals, row["axis"][i], now_ns)
