"""What is watched on each axis while it is controlled: sensors, errors, voltage, oscillation, reference, amplifier.

Each detection is a condition with a time: it must last for so many consecutive cycles, or hold for a mean over that
time. What is noticed goes to ``faults.py``. At rest nothing is watched: a sensor may be unplugged then,
and arming is refused until it is back.
"""

from __future__ import annotations

import math

from micromanip.rt.laws.reference import SAMPLES, SIGNAL
from micromanip.rt.laws.sensor import is_missing
from micromanip.rt.laws.tooth import FOLLOWS, tooth_Hz

from .faults import axis_fault, warn
from .jit import compiled
from .limit_cycle import SWING, watch_swing
from .phases import CHECKING_STAGE, CLOSED, LIFTING, SWEEPING
from .record import Record, record
from .second_order import SECTION, SECTION_STATE, section_output, start_section
from .states import (
    AMPLIFIER_FAULT,
    COASTING,
    DEGRADED,
    DERATED,
    DISAGREEMENT,
    FALLBACK,
    FAULTS,
    FOLLOWING_ERROR,
    HOLDS,
    OSCILLATION,
    OUTRUN,
    OVER_TEMPERATURE,
    REFERENCE_LOST,
    REFERENCE_STALE,
    REFERENCE_STUCK,
    SATURATED,
    SATURATING,
    STAGE,
    STAGE_DRIFT,
    STAGE_INVALID,
    STAGE_STUCK,
    STRAIN_INVALID,
    STRAIN_STUCK,
    TOOTH_LOST,
    TRACKING,
    VOLTAGE,
)

WATCH_PARAMETERS = record(
    ("reaction", "i8", (FAULTS,)),
    ("strain_samples", "i8"),
    ("strain_identical", "i8"),
    ("coast_cycles", "i8"),
    ("stage_samples", "i8"),
    ("stage_identical", "i8"),
    ("degraded_cycles", "i8"),
    ("decay_cycles", "i8"),
    ("innovation_variance", "f8"),
    ("innovation_ratio", "f8"),
    ("innovation_step", "f8"),
    ("drift_gain", "f8"),
    ("drift_um", "f8"),
    ("drift_step", "f8"),
    ("following_um", "f8"),
    ("following_cycles", "i8"),
    ("saturating_cycles", "i8"),
    ("saturated_cycles", "i8"),
    ("band_pass", SECTION),
    ("tooth_notch", SECTION),
    ("band_um", "f8"),
    ("band_step", "f8"),
    ("band_cycles", "i8"),
    ("stale_cycles", "i8"),
    ("lost_cycles", "i8"),
    ("reference_identical", "i8"),
    ("derate", "f8"),
    ("hot_cycles", "i8"),
    ("swings", "i8"),
    ("swing_cycles", "i8"),
)
"""Limits of the fault detection of one axis; times in cycles."""
WATCH_STATE = record(
    ("raised", "i8"),
    ("coast", "i8"),
    ("degraded", "i8"),
    ("innovation", "f8"),
    ("drifts", "i8"),
    ("apart_um", "f8"),
    ("drift_um", "f8"),
    ("following", "i8"),
    ("saturated", "i8"),
    ("error_band", SECTION_STATE),
    ("error_notch", SECTION_STATE),
    ("asked_band", SECTION_STATE),
    ("asked_notch", SECTION_STATE),
    ("band_energy", "f8"),
    ("band_cycles", "i8"),
    ("fallback", "i8"),
    ("hot", "i8"),
    ("driven_swing", SWING),
    ("strain_swing", SWING),
    ("stage_swing", SWING),
)


@compiled
def lasting(count: int, active: bool) -> int:
    """Consecutive cycles for which a condition has been active."""
    return count + 1 if active else 0


@compiled
def watch_strain(p: Record, s: Record, i: int, active: bool) -> None:
    """Strain gauge unusable or stuck: without feedback, on the feedforward alone, for a few ms; then the fault."""
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w, sensor = a["watch"], a["strain"]
    bad = active and sensor["bad"] >= limits["strain_samples"]
    stuck = active and sensor["identical"] >= limits["strain_identical"]
    w["coast"] = lasting(w["coast"], bad or stuck)
    over = w["coast"] > limits["coast_cycles"]
    lost = float(sensor["bad"] if bad else sensor["identical"])
    warn(s, i, COASTING, w["coast"] > 0, lost, float(limits["strain_samples"]))
    axis_fault(p, s, i, STRAIN_INVALID, over and bad, lost, float(limits["strain_samples"]))
    axis_fault(p, s, i, STRAIN_STUCK, over and stuck, lost, float(limits["strain_identical"]))


@compiled
def watch_stage(p: Record, s: Record, i: int, active: bool) -> None:
    """Capacitive sensor unusable or stuck: on the model's prediction for a while (degraded), then the fault.

    When it is back in time the outer loop goes on at once, by calm gains where its demand is far away (``outrun.py``).
    """
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w, sensor = a["watch"], a["stage"]
    bad = active and sensor["bad"] >= limits["stage_samples"]
    stuck = active and sensor["identical"] >= limits["stage_identical"]
    w["degraded"] = lasting(w["degraded"], bad or stuck)
    over = w["degraded"] > limits["degraded_cycles"]
    lost = float(sensor["bad"] if bad else sensor["identical"])
    warn(s, i, DEGRADED, w["degraded"] > 0, lost, float(limits["stage_samples"]))
    axis_fault(p, s, i, STAGE_INVALID, over and bad, lost, float(limits["stage_samples"]))
    axis_fault(p, s, i, STAGE_STUCK, over and stuck, lost, float(limits["stage_identical"]))


@compiled
def watch_innovation(p: Record, s: Record, i: int, active: bool) -> None:
    """Gauge and capacitive sensor disagree: mean square innovation, in units of its variance, over a short time.

    Nobody knows which of the two is wrong: a hold keeps the voltage, not the set-point.
    """
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w, sensor = a["watch"], a["stage"]
    if not active:
        w["innovation"] = 1.0
    elif sensor["fresh"] and w["degraded"] == 0:
        square = a["estimator"]["innovation_um"] ** 2 / limits["innovation_variance"]
        w["innovation"] += limits["innovation_step"] * (square - w["innovation"])
    disagree = active and w["innovation"] > limits["innovation_ratio"]
    if disagree and limits["reaction"][DISAGREEMENT] == HOLDS:
        a["frozen"] = 1
    axis_fault(p, s, i, DISAGREEMENT, disagree, w["innovation"], limits["innovation_ratio"])


@compiled
def watch_drift(p: Record, s: Record, i: int, active: bool) -> None:
    """Gauge and capacitive sensor part so slowly that the Kalman filter takes it for a force.

    That is the mean of the stage less where the gauge says that it is, since the outer loop was closed. A hold keeps
    the voltage, as above.
    """
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], a["watch"]
    if active and a["stage"]["fresh"] and w["degraded"] == 0 and w["coast"] == 0:
        answered_um = a["strain"]["value"] - axis["centre_um"] - a["decoupling"]["added_um"]
        apart_um = a["stage"]["value"] - limits["drift_gain"] * answered_um
        if w["drifts"] == 0:
            w["apart_um"], w["drift_um"] = apart_um, 0.0
        w["drift_um"] += limits["drift_step"] * (apart_um - w["apart_um"] - w["drift_um"])
        w["drifts"] = 1
    elif not active:
        w["drifts"], w["drift_um"] = 0, 0.0
    over = active and abs(w["drift_um"]) > limits["drift_um"]
    if over and limits["reaction"][STAGE_DRIFT] == HOLDS:
        a["frozen"] = 1
    axis_fault(p, s, i, STAGE_DRIFT, over, abs(w["drift_um"]), limits["drift_um"])


@compiled
def watch_tooth(p: Record, s: Record, i: int, active: bool) -> None:
    """The tooth's frequency is not the configured one, nor near it, or its observer makes the estimate worse."""
    axis, estimator = p["axis"][i], s["axis"][i]["estimator"]
    outer, per_ns = axis["outer"], axis["cycles_per_ns"]
    lost = active and outer["tooth"] > 0 and estimator["given_up"] != FOLLOWS
    if lost or s["axis"][i]["watch"]["raised"] & (1 << TOOTH_LOST) != 0:
        said_Hz = outer["tooth_turn"] * per_ns * 1e9 / (2.0 * math.pi)
        warn(s, i, TOOTH_LOST, lost, tooth_Hz(outer, estimator, per_ns), said_Hz)


@compiled
def following_error(p: Record, a: Record) -> float:
    """How far (um) the stage was from the reference, or the gauge from the set-point, by the newest sample."""
    return a["stage_error_um"] if p["mode"] == STAGE else a["strain_error_um"]


@compiled
def watch_following(p: Record, s: Record, i: int, active: bool) -> None:
    """Following error above its limit for some cycles; unknown while its sensor is unusable."""
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w = a["watch"]
    known = active and w["degraded"] == 0 and w["coast"] == 0
    error_um = abs(following_error(p["axis"][i], a))
    w["following"] = lasting(w["following"], known and error_um > limits["following_um"])
    over = w["following"] >= limits["following_cycles"]
    axis_fault(p, s, i, FOLLOWING_ERROR, over, error_um, limits["following_um"])


@compiled
def watch_voltage(p: Record, s: Record, i: int, active: bool) -> None:
    """Voltage at an end of its range: reported after a short time, a fault after a long one."""
    limits, limiter, a = p["axis"][i]["watch"], p["axis"][i]["limiter"], s["axis"][i]
    w = a["watch"]
    at_end = active and (a["request_V"] > limiter["high_V"] or a["request_V"] < limiter["low_V"])
    w["saturated"] = lasting(w["saturated"], at_end)
    cycles = float(w["saturated"])
    warn(s, i, SATURATING, cycles >= limits["saturating_cycles"], a["voltage_V"], float(limits["saturating_cycles"]))
    over = w["saturated"] >= limits["saturated_cycles"]
    axis_fault(p, s, i, SATURATED, over, a["voltage_V"], float(limits["saturated_cycles"]))


@compiled
def watch_oscillation(p: Record, s: Record, i: int, active: bool) -> None:
    """The inner loop swings: energy of its error in the band where it would. First the fallback gains, once.

    Without the tooth's frequency, whose cancelling asks much of the loop, and only what is more than the set-point's
    own there: an error in following is no swing. A loop that swings has the larger error, also where the outer loop
    answers it. The filters take the gauge's samples, not the cycles between: a held one would look like a swing.
    """
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], a["watch"]
    if not active:
        start_section(limits["tooth_notch"], w["error_notch"], start_section(limits["band_pass"], w["error_band"], 0.0))
        asked_um = start_section(limits["band_pass"], w["asked_band"], a["setpoint_um"])
        start_section(limits["tooth_notch"], w["asked_notch"], asked_um)
        w["band_energy"] = 0.0
        w["band_cycles"] = w["fallback"] = 0
    elif a["error_fresh"]:
        error_um = section_output(limits["band_pass"], w["error_band"], a["strain_error_um"])
        error_um = section_output(limits["tooth_notch"], w["error_notch"], error_um)
        asked_um = section_output(limits["band_pass"], w["asked_band"], a["setpoint_um"])
        asked_um = section_output(limits["tooth_notch"], w["asked_notch"], asked_um)
        w["band_energy"] += limits["band_step"] * (error_um * error_um - asked_um * asked_um - w["band_energy"])
    rms_um = math.sqrt(max(0.0, w["band_energy"]))
    w["band_cycles"] = lasting(w["band_cycles"], rms_um > limits["band_um"])
    swings = w["band_cycles"] >= limits["band_cycles"]
    if swings and w["fallback"] == 0:
        w["fallback"], w["band_cycles"] = 1, 0
        swings = False
    warn(s, i, FALLBACK, w["fallback"] != 0, rms_um, limits["band_um"])
    axis_fault(p, s, i, OSCILLATION, swings, rms_um, limits["band_um"])


@compiled
def watch_reference(p: Record, s: Record, i: int, active: bool) -> None:
    """No usable sample of the reference signal: extrapolated for a while, then the hold that decays to 0.

    One that comes in time and reads the same again and again is told: a tracker that has frozen, or a path at rest.
    """
    limits, silent = p["axis"][i]["watch"], s["axis"][i]["reference"]["silent"]
    same = s["axis"][i]["deviation"]["identical"]
    follows = active and p["axis"][i]["reference"]["kind"] == SIGNAL
    stale = follows and silent >= limits["stale_cycles"]
    lost = follows and silent >= limits["lost_cycles"]
    warn(s, i, REFERENCE_STALE, stale, float(silent), float(limits["stale_cycles"]))
    stuck = follows and same >= limits["reference_identical"]
    warn(s, i, REFERENCE_STUCK, stuck, float(same), float(limits["reference_identical"]))
    axis_fault(p, s, i, REFERENCE_LOST, lost, float(silent), float(limits["lost_cycles"]))


@compiled
def watch_amplifier(p: Record, s: Record, i: int, active: bool) -> None:
    """Status signals of the amplifier; one that is hot gets less to do before the fault."""
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], a["watch"]
    axis_fault(p, s, i, AMPLIFIER_FAULT, active and is_missing(axis["amplifier_ok"], a["amplifier_ok"]), 0.0, 1.0)
    w["hot"] = lasting(w["hot"], active and is_missing(axis["temperature_ok"], a["temperature_ok"]))
    warn(s, i, DERATED, w["hot"] > 0, 100.0 * limits["derate"], 100.0)
    axis_fault(p, s, i, OVER_TEMPERATURE, w["hot"] > limits["hot_cycles"], float(w["hot"]), float(limits["hot_cycles"]))


@compiled
def is_excited(axis: Record, a: Record) -> bool:
    """Whether an axis is moved in open loop for a recording: its gauge is needed then, as if the loop were closed."""
    played = axis["mode"] == VOLTAGE and axis["reference"]["kind"] == SAMPLES
    return played and a["setpoint_um"] != axis["limiter"]["park_V"]


@compiled
def watch_axis(p: Record, s: Record, i: int, moving: bool, enabled: bool) -> None:
    """Watch axis `i` by what it did in the cycle before: its loops while `moving`, its amplifier while `enabled`."""
    axis, phase = p["axis"][i], s["phase"]
    lifts = phase == LIFTING and s["axis"][i]["lifted"] != 0
    driven = moving and (phase == CLOSED or lifts or phase in (CHECKING_STAGE, SWEEPING))
    inner = driven and axis["mode"] != VOLTAGE
    outer = moving and axis["mode"] == STAGE and phase == CLOSED
    tracking = moving and s["state"] == TRACKING
    watch_strain(p, s, i, inner or (driven and is_excited(axis, s["axis"][i])))
    watch_stage(p, s, i, outer)
    watch_innovation(p, s, i, outer)
    watch_drift(p, s, i, outer)
    watch_tooth(p, s, i, outer)
    watch_following(p, s, i, tracking and axis["mode"] != VOLTAGE)
    watch_voltage(p, s, i, inner)
    watch_oscillation(p, s, i, inner and axis["feedback"] != 0)
    warn(s, i, OUTRUN, outer and s["axis"][i]["far"] > 0, 0.0, 0.0)
    watch_swing(p, s, i, driven)
    watch_reference(p, s, i, tracking)
    watch_amplifier(p, s, i, enabled)
