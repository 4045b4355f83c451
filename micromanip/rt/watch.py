"""Monitors each axis while it is controlled: sensors, errors, voltage, oscillation, reference, amplifier.

Each detection is a condition with a time: it must last for so many consecutive cycles, or hold for a mean over that
time. All conditions of an axis are bits of one word. Only if the word changes are they checked one by one, in the order
of ``states.WATCHED``, and passed to ``faults.py``. At rest nothing is monitored: a sensor may be unplugged, and arming
is refused until it is back.
"""

from __future__ import annotations

import math

from micromanip.rt.laws.frequency_lock import FOLLOWS, tooth_Hz
from micromanip.rt.laws.reference import SAMPLES, SIGNAL
from micromanip.rt.laws.saturation import beyond
from micromanip.rt.laws.sensor import is_silent

from . import states
from .digital_io import is_missing
from .errors import following_error
from .faults import axis_fault
from .jit import compiled
from .oscillation import SECTION, SECTION_STATE, SWING, swing_um, swings_for, watch_oscillation, watch_swings
from .record import Record, record
from .states import CHECKING_STAGE, CLOSED, LIFTING, SWEEPING

WATCH_PARAMETERS = record(
    ("reaction", "i8", (states.EVENT_CODES,)),
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
"""Limits of the fault detection of one axis; times in cycles. The reaction to a warning is WARN."""
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
    ("swing", SWING, (3,)),
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
def watch_strain(axis: Record, a: Record, w: Record, active: bool) -> int:
    """Strain gauge silent, unusable or stuck: on the feedforward alone for a few ms; then the fault."""
    limits, sensor = axis["watch"], a["strain"]
    bad = active and sensor["bad"] >= limits["strain_samples"]
    stuck = active and sensor["identical"] >= limits["strain_identical"]
    w["coast"] = coast = lasting(w["coast"], bad or stuck)
    over, silent = coast > limits["coast_cycles"], is_silent(sensor, axis["strain_age_ns"])
    found = condition(states.COASTING, coast > 0) | condition(states.STRAIN_STUCK, over and stuck)
    found |= condition(states.STRAIN_SILENT, over and bad and silent)
    return found | condition(states.STRAIN_INVALID, over and bad and not silent)


@compiled
def watch_stage(limits: Record, a: Record, w: Record, active: bool) -> int:
    """Capacitive sensor unusable or stuck: on the model's prediction for a while (degraded), then the fault.

    If it is back in time, the outer loop resumes at once, with calm gains if the error is large (``supervisor.py``).
    """
    bad = active and a["stage"]["bad"] >= limits["stage_samples"]
    stuck = active and a["stage"]["identical"] >= limits["stage_identical"]
    w["degraded"] = degraded = lasting(w["degraded"], bad or stuck)
    over = degraded > limits["degraded_cycles"]
    found = condition(states.DEGRADED, degraded > 0)
    return found | condition(states.STAGE_INVALID, over and bad) | condition(states.STAGE_STUCK, over and stuck)


@compiled
def watch_apart(axis: Record, a: Record, w: Record, active: bool) -> int:
    """Gauge and capacitive sensor disagree, suddenly or slowly; either may be wrong: a hold keeps the voltage.

    Suddenly: mean square innovation, in units of its variance, over a short time. Slowly, so that the Kalman filter
    takes it for a force: the slow mean of stage minus gauge's prediction, compared with its mean just after the outer
    loop was closed.
    """
    limits = axis["watch"]
    if not active:
        w["innovation"] = 1.0
        w["settling"], w["apart_um"], w["drift_um"] = 0, 0.0, 0.0
        return 0
    if a["stage"]["fresh"] and w["degraded"] == 0:
        square = a["estimator"]["innovation_um"] ** 2 / limits["innovation_variance"]
        w["innovation"] += limits["innovation_step"] * (square - w["innovation"])
        if w["coast"] == 0:
            answered_um = a["strain"]["value"] - axis["centre_um"] - a["added_um"]
            apart_um = a["stage"]["value"] - limits["drift_gain"] * answered_um
            if limits["drift_step"] * w["settling"] < 1.0:
                w["settling"] += 1
                w["apart_um"] += (apart_um - w["apart_um"]) / w["settling"]
            else:
                w["drift_um"] += limits["drift_step"] * (apart_um - w["apart_um"] - w["drift_um"])
    disagree = w["innovation"] > limits["innovation_ratio"]
    drifts, reaction = abs(w["drift_um"]) > limits["drift_um"], limits["reaction"]
    holds = disagree and reaction[states.DISAGREEMENT] == states.HOLDS
    if holds or (drifts and reaction[states.STAGE_DRIFT] == states.HOLDS):
        w["frozen"] = 1
    return condition(states.DISAGREEMENT, disagree) | condition(states.STAGE_DRIFT, drifts)


@compiled
def watch_following(axis: Record, a: Record, w: Record, active: bool) -> int:
    """Following error above its limit for some cycles; unknown while its sensor is unusable."""
    limits, known = axis["watch"], active and w["degraded"] == 0 and w["coast"] == 0
    far = known and abs(following_error(axis, a)) > limits["following_um"]
    w["following"] = following = lasting(w["following"], far)
    return condition(states.FOLLOWING_ERROR, following >= limits["following_cycles"])


@compiled
def watch_voltage(axis: Record, a: Record, w: Record, active: bool) -> int:
    """Voltage at an end of its range: reported after a short time, a fault after a long one."""
    limits, at_end = axis["watch"], active and beyond(axis["limiter"], a["request_V"]) != 0
    w["saturated"] = cycles = lasting(w["saturated"], at_end)
    found = condition(states.SATURATING, cycles >= limits["saturating_cycles"])
    return found | condition(states.SATURATED, cycles >= limits["saturated_cycles"])


@compiled
def watch_inner(axis: Record, a: Record, w: Record, active: bool) -> int:
    """The inner loop oscillates (``oscillation.py``): first the fallback gains, once."""
    limits = axis["watch"]
    watch_oscillation(limits, a, w, active)
    w["band_cycles"] = lasting(w["band_cycles"], swing_um(w) > limits["band_um"])
    swings = w["band_cycles"] >= limits["band_cycles"]
    if not active:
        w["fallback"] = 0
    elif swings and w["fallback"] == 0:
        w["fallback"], w["band_cycles"] = 1, 0
        swings = False
    return condition(states.FALLBACK, w["fallback"] != 0) | condition(states.OSCILLATION, swings)


@compiled
def watch_reference(axis: Record, a: Record, active: bool) -> int:
    """No usable sample of the reference signal: extrapolated for a while, then the hold that decays to 0.

    Samples that come in time and are identical are reported: a frozen tracker, or a path at rest.
    """
    if not active or axis["reference"]["kind"] != SIGNAL:
        return 0
    limits, silent, same = axis["watch"], a["reference"]["silent"], a["deviation"]["identical"]
    found = condition(states.REFERENCE_STALE, silent >= limits["stale_cycles"])
    found |= condition(states.REFERENCE_STUCK, same >= limits["reference_identical"])
    return found | condition(states.REFERENCE_LOST, silent >= limits["lost_cycles"])


@compiled
def watch_amplifier(axis: Record, a: Record, w: Record, active: bool) -> int:
    """Status signals of the amplifier; a hot amplifier gets a smaller correction before the fault."""
    w["hot"] = hot = lasting(w["hot"], active and is_missing(axis["temperature_ok"], a["temperature_ok"]))
    found = condition(states.AMPLIFIER_FAULT, active and is_missing(axis["amplifier_ok"], a["amplifier_ok"]))
    found |= condition(states.OVER_TEMPERATURE, hot > axis["watch"]["hot_cycles"])
    return found | condition(states.DERATED, hot > 0)


@compiled
def watch_axis(p: Record, s: Record, i: int, moving: bool, enabled: bool) -> None:
    """Monitor axis `i` by its results of the cycle before: its loops while `moving`, its amplifier while `enabled`.

    The tooth is lost if its frequency is not near the configured one, or if its observer makes the estimate worse.
    """
    axis, a, w, phase = p["axis"][i], s["axis"][i], s["watch"][i], s["phase"]
    lifts = phase == LIFTING and s["arming"][i]["lifted"] != 0
    driven = moving and (phase == CLOSED or lifts or phase in (CHECKING_STAGE, SWEEPING))
    inner = driven and axis["mode"] != states.VOLTAGE
    outer = moving and axis["mode"] == states.STAGE and phase == CLOSED
    tracking = moving and s["state"] == states.TRACKING
    tooth_lost = outer and axis["outer"]["tooth"] > 0 and a["estimator"]["given_up"] != FOLLOWS
    # moved in open loop for a recording: the gauge is needed then, as if the loop were closed
    played = driven and not inner and axis["reference"]["kind"] == SAMPLES
    found = watch_strain(axis, a, w, inner or (played and a["setpoint_um"] != axis["limiter"]["park_V"]))
    found |= watch_stage(axis["watch"], a, w, outer)
    found |= watch_apart(axis, a, w, outer)
    found |= condition(states.TOOTH_LOST, tooth_lost)
    found |= watch_following(axis, a, w, tracking and axis["mode"] != states.VOLTAGE)
    found |= watch_voltage(axis, a, w, inner)
    found |= watch_inner(axis, a, w, inner and axis["feedback"] != 0)
    found |= condition(states.OUTRUN, outer and a["supervisor"]["calm_left"] > 0)
    found |= condition(states.LIMIT_CYCLE, watch_swings(axis, a, w, s["cycle"], driven))
    found |= watch_reference(axis, a, tracking)
    found |= watch_amplifier(axis, a, w, enabled)
    if (found ^ w["raised"]) & _WATCHED_BITS != 0:
        tell_changes(p, s, i, found)


@compiled.rare
def tell_changes(p: Record, s: Record, i: int, found: int) -> None:
    """Report each condition of axis `i` that begins, of those active now."""
    for code in states.WATCHED:
        value, limit = measured(p, s, i, code)
        axis_fault(p, s, i, code, found >> code & 1 != 0, value, limit)


@compiled
def loss(sensor: Record, samples: int, identical: int, patience: int, stuck: bool) -> tuple[float, float]:
    """How many samples of a sensor were unusable, or identical, and of how many it is `stuck`, or was waited for."""
    lost = sensor["bad"] if sensor["bad"] >= samples else sensor["identical"]
    return float(lost), float(identical if stuck else samples + patience)


@compiled
def measured(p: Record, s: Record, i: int, code: int) -> tuple[float, float]:
    """What was measured for a condition of axis `i`, and its limit."""
    axis, a = p["axis"][i], s["axis"][i]
    limits, w = axis["watch"], s["watch"][i]
    if code in (states.COASTING, states.STRAIN_SILENT, states.STRAIN_INVALID, states.STRAIN_STUCK):
        samples, identical, stuck = limits["strain_samples"], limits["strain_identical"], code == states.STRAIN_STUCK
        return loss(a["strain"], samples, identical, limits["coast_cycles"], stuck)
    if code in (states.DEGRADED, states.STAGE_INVALID, states.STAGE_STUCK):
        samples, identical, stuck = limits["stage_samples"], limits["stage_identical"], code == states.STAGE_STUCK
        return loss(a["stage"], samples, identical, limits["degraded_cycles"], stuck)
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
