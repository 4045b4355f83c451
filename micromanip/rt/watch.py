"""What is watched on each axis while it is controlled: sensors, errors, voltage, oscillation, reference, amplifier.

Each detection is a condition with a time: it must last for so many consecutive cycles, or hold for a mean over that
time. All conditions of an axis are one word, a bit each. Only where it changes are they looked at one by one, in the
order of ``states.WATCHED``, and go to ``faults.py``. At rest nothing is watched: a sensor may be unplugged then, and
arming is refused until it is back.
"""

from __future__ import annotations

import math

from micromanip.rt.laws.digital_input import is_missing
from micromanip.rt.laws.reference import SAMPLES, SIGNAL
from micromanip.rt.laws.saturation import beyond
from micromanip.rt.laws.sensor import is_silent
from micromanip.rt.laws.tooth import FOLLOWS, tooth_Hz

from . import states
from .faults import axis_fault, warn
from .jit import compiled
from .limit_cycle import SWING, swings_for, watch_swing
from .phases import CHECKING_STAGE, CLOSED, LIFTING, SWEEPING
from .record import Record, record
from .second_order import SECTION, SECTION_STATE, section_output, start_section

WATCH_PARAMETERS = record(
    ("reaction", "i8", (states.FAULTS,)),
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
    ("frozen", "i8"),
    ("coast", "i8"),
    ("degraded", "i8"),
    ("innovation", "f8"),
    ("settling", "i8"),
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

_WATCHED_BITS = sum(1 << code for code in states.WATCHED)


@compiled
def lasting(count: int, active: bool) -> int:
    """Consecutive cycles for which a condition has been active."""
    return count + 1 if active else 0


@compiled
def condition(code: int, active: bool) -> int:
    """The bit of a condition that stands."""
    return int(active) << code


@compiled
def watch_strain(p: Record, s: Record, i: int, active: bool) -> int:
    """Strain gauge silent, unusable or stuck: on the feedforward alone for a few ms; then the fault."""
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w, sensor = s["watch"][i], a["strain"]
    bad = active and sensor["bad"] >= limits["strain_samples"]
    stuck = active and sensor["identical"] >= limits["strain_identical"]
    coast = lasting(w["coast"], bad or stuck)
    w["coast"], over = coast, coast > limits["coast_cycles"]
    silent = is_silent(sensor, p["axis"][i]["strain_age_ns"])
    found = condition(states.COASTING, coast > 0) | condition(states.STRAIN_STUCK, over and stuck)
    found |= condition(states.STRAIN_SILENT, over and bad and silent)
    return found | condition(states.STRAIN_INVALID, over and bad and not silent)


@compiled
def watch_stage(p: Record, s: Record, i: int, active: bool) -> int:
    """Capacitive sensor unusable or stuck: on the model's prediction for a while (degraded), then the fault.

    When it is back in time the outer loop goes on at once, by calm gains where it is far away (``supervisor.py``).
    """
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w, sensor = s["watch"][i], a["stage"]
    bad = active and sensor["bad"] >= limits["stage_samples"]
    stuck = active and sensor["identical"] >= limits["stage_identical"]
    degraded = lasting(w["degraded"], bad or stuck)
    w["degraded"], over = degraded, degraded > limits["degraded_cycles"]
    found = condition(states.DEGRADED, degraded > 0)
    return found | condition(states.STAGE_INVALID, over and bad) | condition(states.STAGE_STUCK, over and stuck)


@compiled
def watch_innovation(p: Record, s: Record, i: int, active: bool) -> int:
    """Gauge and capacitive sensor disagree: mean square innovation, in units of its variance, over a short time.

    Nobody knows which of the two is wrong: a hold keeps the voltage, not the set-point.
    """
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w, sensor = s["watch"][i], a["stage"]
    if not active:
        w["innovation"] = 1.0
    elif sensor["fresh"] and w["degraded"] == 0:
        square = a["estimator"]["innovation_um"] ** 2 / limits["innovation_variance"]
        w["innovation"] += limits["innovation_step"] * (square - w["innovation"])
    disagree = active and w["innovation"] > limits["innovation_ratio"]
    if disagree and limits["reaction"][states.DISAGREEMENT] == states.HOLDS:
        w["frozen"] = 1
    return condition(states.DISAGREEMENT, disagree)


@compiled
def watch_drift(p: Record, s: Record, i: int, active: bool) -> int:
    """Gauge and capacitive sensor part so slowly that the Kalman filter takes it for a force.

    That is the slow mean of the stage less where the gauge says that it is, beside the mean of the first while behind
    the outer loop's closing. A hold keeps the voltage, as above.
    """
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], s["watch"][i]
    if active and a["stage"]["fresh"] and w["degraded"] == 0 and w["coast"] == 0:
        answered_um = a["strain"]["value"] - axis["centre_um"] - a["decoupling"]["added_um"]
        apart_um = a["stage"]["value"] - limits["drift_gain"] * answered_um
        if limits["drift_step"] * w["settling"] < 1.0:
            w["settling"] += 1
            w["apart_um"] += (apart_um - w["apart_um"]) / w["settling"]
        else:
            w["drift_um"] += limits["drift_step"] * (apart_um - w["apart_um"] - w["drift_um"])
    elif not active:
        w["settling"], w["apart_um"], w["drift_um"] = 0, 0.0, 0.0
    over = active and abs(w["drift_um"]) > limits["drift_um"]
    if over and limits["reaction"][states.STAGE_DRIFT] == states.HOLDS:
        w["frozen"] = 1
    return condition(states.STAGE_DRIFT, over)


@compiled
def watch_tooth(p: Record, s: Record, i: int, active: bool) -> int:
    """The tooth's frequency is not the configured one, nor near it, or its observer makes the estimate worse."""
    lost = active and p["axis"][i]["outer"]["tooth"] > 0 and s["axis"][i]["estimator"]["given_up"] != FOLLOWS
    return condition(states.TOOTH_LOST, lost)


@compiled
def following_error(p: Record, a: Record) -> float:
    """How far (um) the stage was from the reference, or the gauge from the set-point, by the newest sample."""
    return a["stage_error_um"] if p["mode"] == states.STAGE else a["strain_error_um"]


@compiled
def watch_following(p: Record, s: Record, i: int, active: bool) -> int:
    """Following error above its limit for some cycles; unknown while its sensor is unusable."""
    limits, a = p["axis"][i]["watch"], s["axis"][i]
    w = s["watch"][i]
    known = active and w["degraded"] == 0 and w["coast"] == 0
    following = lasting(w["following"], known and abs(following_error(p["axis"][i], a)) > limits["following_um"])
    w["following"] = following
    return condition(states.FOLLOWING_ERROR, following >= limits["following_cycles"])


@compiled
def watch_voltage(p: Record, s: Record, i: int, active: bool) -> int:
    """Voltage at an end of its range: reported after a short time, a fault after a long one."""
    limits, limiter, a = p["axis"][i]["watch"], p["axis"][i]["limiter"], s["axis"][i]
    w = s["watch"][i]
    at_end = active and beyond(limiter, a["request_V"]) != 0
    cycles = lasting(w["saturated"], at_end)
    w["saturated"] = cycles
    found = condition(states.SATURATING, cycles >= limits["saturating_cycles"])
    return found | condition(states.SATURATED, cycles >= limits["saturated_cycles"])


@compiled
def swing_um(w: Record) -> float:
    """The rms (um) of what swings in the band."""
    return math.sqrt(max(0.0, w["band_energy"]))


@compiled
def watch_oscillation(p: Record, s: Record, i: int, active: bool) -> int:
    """The inner loop swings: energy of its error in the band where it would. First the fallback gains, once.

    Without the tooth's frequency, whose cancelling asks much of the loop, and only what is more than the set-point's
    own there: an error in following is no swing. A loop that swings has the larger error, also where the outer loop
    answers it. The filters take the gauge's samples, not the cycles between: a held one would look like a swing.
    """
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], s["watch"][i]
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
    w["band_cycles"] = lasting(w["band_cycles"], swing_um(w) > limits["band_um"])
    swings = w["band_cycles"] >= limits["band_cycles"]
    if swings and w["fallback"] == 0:
        w["fallback"], w["band_cycles"] = 1, 0
        swings = False
    return condition(states.FALLBACK, w["fallback"] != 0) | condition(states.OSCILLATION, swings)


@compiled
def watch_reference(p: Record, s: Record, i: int, active: bool) -> int:
    """No usable sample of the reference signal: extrapolated for a while, then the hold that decays to 0.

    One that comes in time and reads the same again and again is told: a tracker that has frozen, or a path at rest.
    """
    limits, silent = p["axis"][i]["watch"], s["axis"][i]["reference"]["silent"]
    same = s["axis"][i]["deviation"]["identical"]
    follows = active and p["axis"][i]["reference"]["kind"] == SIGNAL
    found = condition(states.REFERENCE_STALE, follows and silent >= limits["stale_cycles"])
    found |= condition(states.REFERENCE_STUCK, follows and same >= limits["reference_identical"])
    return found | condition(states.REFERENCE_LOST, follows and silent >= limits["lost_cycles"])


@compiled
def watch_amplifier(p: Record, s: Record, i: int, active: bool) -> int:
    """Status signals of the amplifier; one that is hot gets less to do before the fault."""
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], s["watch"][i]
    hot = lasting(w["hot"], active and is_missing(axis["temperature_ok"], a["temperature_ok"]))
    w["hot"] = hot
    found = condition(states.AMPLIFIER_FAULT, active and is_missing(axis["amplifier_ok"], a["amplifier_ok"]))
    return found | condition(states.DERATED, hot > 0) | condition(states.OVER_TEMPERATURE, hot > limits["hot_cycles"])


@compiled
def is_excited(axis: Record, a: Record) -> bool:
    """Whether an axis is moved in open loop for a recording: its gauge is needed then, as if the loop were closed."""
    played = axis["mode"] == states.VOLTAGE and axis["reference"]["kind"] == SAMPLES
    return played and a["setpoint_um"] != axis["limiter"]["park_V"]


@compiled
def watch_axis(p: Record, s: Record, i: int, moving: bool, enabled: bool) -> None:
    """Watch axis `i` by what it did in the cycle before: its loops while `moving`, its amplifier while `enabled`."""
    axis, phase = p["axis"][i], s["phase"]
    lifts = phase == LIFTING and s["arming"][i]["lifted"] != 0
    driven = moving and (phase == CLOSED or lifts or phase in (CHECKING_STAGE, SWEEPING))
    inner = driven and axis["mode"] != states.VOLTAGE
    outer = moving and axis["mode"] == states.STAGE and phase == CLOSED
    tracking = moving and s["state"] == states.TRACKING
    found = watch_strain(p, s, i, inner or (driven and is_excited(axis, s["axis"][i])))
    found |= watch_stage(p, s, i, outer)
    found |= watch_innovation(p, s, i, outer)
    found |= watch_drift(p, s, i, outer)
    found |= watch_tooth(p, s, i, outer)
    found |= watch_following(p, s, i, tracking and axis["mode"] != states.VOLTAGE)
    found |= watch_voltage(p, s, i, inner)
    found |= watch_oscillation(p, s, i, inner and axis["feedback"] != 0)
    found |= condition(states.OUTRUN, outer and s["axis"][i]["supervisor"]["calm_left"] > 0)
    found |= condition(states.LIMIT_CYCLE, watch_swing(p, s, i, driven))
    found |= watch_reference(p, s, i, tracking)
    found |= watch_amplifier(p, s, i, enabled)
    if (found ^ s["watch"][i]["raised"]) & _WATCHED_BITS != 0:
        tell_changes(p, s, i, found)


@compiled.rare
def tell_changes(p: Record, s: Record, i: int, found: int) -> None:
    """Tell of each condition that begins on axis `i`, of those that stand by now."""
    for code in states.WATCHED:
        active = found >> code & 1 != 0
        value, limit = measured(p, s, i, code)
        if code >= states.FAULTS:
            warn(s, i, code, active, value, limit)
        else:
            axis_fault(p, s, i, code, active, value, limit)


@compiled
def measured(p: Record, s: Record, i: int, code: int) -> tuple[float, float]:
    """What was measured for a condition of axis `i`, and its limit."""
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], s["watch"][i]
    if code in (states.COASTING, states.STRAIN_SILENT, states.STRAIN_INVALID, states.STRAIN_STUCK):
        sensor, samples, identical = a["strain"], limits["strain_samples"], limits["strain_identical"]
        lost = sensor["bad"] if sensor["bad"] >= samples else sensor["identical"]
        return float(lost), float(identical if code == states.STRAIN_STUCK else samples + limits["coast_cycles"])
    if code in (states.DEGRADED, states.STAGE_INVALID, states.STAGE_STUCK):
        sensor, samples, identical = a["stage"], limits["stage_samples"], limits["stage_identical"]
        lost = sensor["bad"] if sensor["bad"] >= samples else sensor["identical"]
        return float(lost), float(identical if code == states.STAGE_STUCK else samples + limits["degraded_cycles"])
    if code == states.DISAGREEMENT:
        return w["innovation"], limits["innovation_ratio"]
    if code == states.STAGE_DRIFT:
        return abs(w["drift_um"]), limits["drift_um"]
    if code == states.TOOTH_LOST:
        outer, per_ns = axis["outer"], axis["cycles_per_ns"]
        return tooth_Hz(outer, a["estimator"], per_ns), outer["tooth_turn"] * per_ns * 1e9 / (2.0 * math.pi)
    if code == states.FOLLOWING_ERROR:
        return abs(following_error(axis, a)), limits["following_um"]
    if code in (states.SATURATING, states.SATURATED):
        cycles = limits["saturating_cycles"] if code == states.SATURATING else limits["saturated_cycles"]
        return a["voltage_V"], float(cycles)
    if code in (states.FALLBACK, states.OSCILLATION):
        return swing_um(w), limits["band_um"]
    if code == states.LIMIT_CYCLE:
        return swings_for(axis, a, w, s["cycle"]) * p["period_ns"] * 1e-9, float(limits["swings"])
    if code in (states.REFERENCE_STALE, states.REFERENCE_LOST):
        cycles = limits["stale_cycles"] if code == states.REFERENCE_STALE else limits["lost_cycles"]
        return float(a["reference"]["silent"]), float(cycles)
    if code == states.REFERENCE_STUCK:
        return float(a["deviation"]["identical"]), float(limits["reference_identical"])
    if code == states.DERATED:
        return 100.0 * limits["derate"], 100.0
    if code == states.OVER_TEMPERATURE:
        return float(w["hot"]), float(limits["hot_cycles"])
    return 0.0, 1.0 if code == states.AMPLIFIER_FAULT else 0.0
