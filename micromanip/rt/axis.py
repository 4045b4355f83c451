"""THE hot path: one cycle of one axis.

sample -> Kalman estimate -> LQG (stage position) -> actuator set-point -> inverse hysteresis
(feedforward) + PID on the strain gauge (feedback) -> limiter -> voltage -> telemetry

Budget: three axes with 6 plays and 11 states take about 1-2 us of the 100 us period (`micromanip
bench` measures it beside a C twin). Nothing here allocates, raises or calls Python.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.estimator import output, predict_to, remember, start_estimator, update
from micromanip.rt.laws.excitation import excitation
from micromanip.rt.laws.feedforward import feedforward_voltage, start_feedforward
from micromanip.rt.laws.learned import add_learned, forget_played
from micromanip.rt.laws.limiter import limit
from micromanip.rt.laws.lqg import outer_setpoint
from micromanip.rt.laws.move import advance_move
from micromanip.rt.laws.pid import pid_output, retune, start_pid, unwind
from micromanip.rt.laws.reference import (
    JOG,
    REFERENCE_STATES,
    SIGNAL,
    jog_reference,
    own_reference,
    previewed,
    signal_reference,
    signal_sample,
)
from micromanip.rt.laws.sensor import read_line, read_signal

from .jit import compiled
from .outrun import FAR, attainable, come_back, forget_unseen, is_disturbed, leave_path, saw_late
from .phases import CHECKING_GAUGE, CHECKING_STAGE, CLOSED, FROZEN, LIFTING, PARKING, SWEEPING
from .record import Record
from .setpoint_history import ease_times, measure_errors, remember_setpoint, start_history, start_times
from .states import STAGE, VOLTAGE
from .waiting import no_further, waits

_ANY_UM = (-math.inf, math.inf)


@compiled.rare
def axis_cycle(
    p: Record, s: Record, cycle: int, now_ns: int, t_s: float, samples: Any, phase: int, fraction: float
) -> bool:
    """Advance the axis by one cycle; False where any stage of its law gave no finite number.

    The set-point and the voltage before that stay then.

    `fraction` runs 0..1 through a lift or a parking ramp, or is the correction's authority; `t_s` and `samples` are
    the own source's. ``offset`` (um, or V while probing) comes on top in a check or a sweep.
    """
    steady = may_be_excited(s, phase, fraction) and (p["mode"] != STAGE or s["estimator"]["running"] != 0)
    advance_move(p["move"], s["move"], cycle, steady)
    if phase in (LIFTING, CHECKING_STAGE, SWEEPING, CLOSED):
        estimate(p, s, cycle)
        if s["preview_s"] != p["preview_s"] or s["awaited_cycles"] != p["awaited_cycles"]:
            ease_times(p, s)
        track_reference(p, s, now_ns, t_s, samples)
        if 0 < 2 * p["learned"]["rows"] <= len(samples):
            follows = fraction == 1.0 and may_be_excited(s, phase, fraction)
            add_learned(p["learned"], s["learned"], s["reference"]["w"], samples, cycle, follows)
        added_um = 0.0
        if p["excitation"]["lines"] > 0:
            added_um = excitation(p["excitation"], s["excitation"], cycle, may_be_excited(s, phase, fraction))
        finite = move_setpoint(p, s, demand(p, s, phase, fraction) + added_um)
        remember_setpoint(s, cycle)
        measure_errors(p, s, cycle)
        s["request_V"] = request_voltage(p, s, phase, fraction)
        finite = finite and is_finite(p, s, phase)
        s["voltage_V"] = limit(p["limiter"], s["voltage_V"], s["request_V"], True)
        unwind(p["pid"], s["pid"], s["request_V"] - s["voltage_V"])
        remember(s["estimator"], s["setpoint_um"] - p["centre_um"] - s["decoupling"]["added_um"])
    else:
        measure_errors(p, s, cycle)
        if phase == FROZEN:
            s["request_V"] = s["voltage_V"]
        elif phase == CHECKING_GAUGE:
            s["request_V"] = s["start_V"] + s["offset"]
        else:
            s["request_V"] = s["start_V"] + fraction * (p["limiter"]["park_V"] - s["start_V"])
        finite = math.isfinite(s["request_V"])
        permitted = phase in (PARKING, CHECKING_GAUGE, FROZEN)
        s["voltage_V"] = limit(p["limiter"], s["voltage_V"], s["request_V"], permitted)
    return finite


@compiled
def sample(p: Record, s: Record, signals: Record, now_ns: int, missed: int) -> None:
    """Take the axis' signals from the process image, after `missed` cycles."""
    s["strain_cycles"] += 1
    forget_unseen(s, missed)
    s["reference"]["silent"] += 1
    if p["strain"] >= 0:
        age_ns, rate = p["strain_age_ns"], p["strain_rate_um_per_ns"]
        read_signal(signals[p["strain"]], s["strain"], now_ns, age_ns, p["strain_range_um"], rate)
    if p["stage"] >= 0:
        age_ns, rate = p["stage_age_ns"], p["stage_rate_um_per_ns"]
        read_signal(signals[p["stage"]], s["stage"], now_ns, age_ns, p["stage_range_um"], rate)
    if p["deviation"] >= 0:
        deviation = s["deviation"]
        if read_signal(signals[p["deviation"]], deviation, now_ns, p["reference_age_ns"], _ANY_UM, math.inf):
            signal_sample(p["reference"], s["reference"], deviation["value"], deviation["time_ns"])
    read_line(p["amplifier_ok"], s["amplifier_ok"], signals, now_ns)
    read_line(p["temperature_ok"], s["temperature_ok"], signals, now_ns)


@compiled
def estimate(p: Record, s: Record, cycle: int) -> None:
    """Kalman filter: predict to this cycle, correct with a fresh capacitive sample at its own age.

    It starts with a fresh sample only: what the sensor said before may be old.
    """
    if p["mode"] != STAGE:
        return
    if s["estimator"]["running"] == 0:
        if s["stage"]["fresh"]:
            u = s["setpoint_um"] - p["centre_um"] - s["decoupling"]["added_um"]
            start_estimator(p["outer"], s["estimator"], cycle, u, s["stage"]["value"])
        return
    predict_to(p["outer"], s["estimator"], cycle)
    if s["stage"]["fresh"] and s["watch"]["degraded"] == 0:
        age = int(s["stage"]["age_ns"] * p["cycles_per_ns"] + 0.5)
        update(p["outer"], s["estimator"], cycle - age, s["stage"]["value"])


@compiled
def demand(p: Record, s: Record, phase: int, fraction: float) -> float:
    """What the set-point should be, before its limits: um, or V in the open-loop mode.

    With the outer loop closed, `fraction` of the way from where the axis was held to its reference. Without an
    estimate that runs there is no outer loop: the set-point stays. Where it can't follow, calmer gains demand it
    (``outrun.py``).
    """
    w = s["reference"]["w"]
    stage = p["mode"] == STAGE
    follows = p["reference"]["kind"] == SIGNAL
    s["authority"] += max(-p["authority_step"], min(p["authority_step"], authority(p, s) - s["authority"]))
    if phase != CLOSED:
        target = p["centre_um"] if stage or follows else s["ahead_um"]
        return s["start_um"] + fraction * (target - s["start_um"]) + s["offset"]
    if stage and s["estimator"]["running"] == 0:
        return s["setpoint_um"]
    if s["closed"] == 0:
        s["hold_um"] = output(p["outer"], s["estimator"]["x"]) if stage else s["setpoint_um"]
    s["hold_um"] += s["move"]["speed_um"]
    if not stage:
        s["closed"] = 1
        target = p["centre_um"] + s["authority"] * w[0] if follows else s["ahead_um"]
        rest = p["centre_um"] if follows else s["hold_um"]
        held = rest + s["hold_scale"] * (s["hold_um"] - rest)
        return held + fraction * (target - held)
    held = s["hold_scale"] * s["hold_um"]
    w[0] = held + fraction * (s["authority"] * w[0] - held)
    for i in range(1, REFERENCE_STATES):
        w[i] *= fraction * s["authority"]
    w[1] += s["move"]["speed_um"] * p["cycles_per_ns"] * 1e9
    w[2] += s["move"]["acceleration_um"] * (p["cycles_per_ns"] * 1e9) ** 2
    outer, x, rest = p["outer"], s["estimator"]["x"], p["centre_um"] + s["decoupling"]["added_um"]
    near_um = rest + outer_setpoint(outer, outer["feedback"], outer["reference"], x, w)
    if s["closed"] == 0:
        s["blend_um"] = s["setpoint_um"] - near_um
        s["closed"] = 1
    s["blend_um"] *= p["blend_decay"]
    if is_disturbed(s):
        s["far"] = FAR
    if s["far"] == 0:
        leave_path(p, s, s["estimator"]["cycle"], near_um + s["blend_um"])
    if s["far"] == 0:
        return near_um + s["blend_um"]
    far_um = rest + outer_setpoint(outer, outer["far_feedback"], outer["far_reference"], x, w)
    come_back(p, s, far_um)
    s["blend_um"] = s["setpoint_um"] - near_um
    return far_um


@compiled
def may_be_excited(s: Record, phase: int, fraction: float) -> bool:
    """Whether the axis tracks or is held, with both sensors and its own gains: not on its way anywhere."""
    w = s["watch"]
    steady = phase == CLOSED and (fraction == 0.0 or fraction == 1.0)
    return steady and w["coast"] == 0 and w["degraded"] == 0 and w["fallback"] == 0 and s["far"] == 0


@compiled
def authority(p: Record, s: Record) -> float:
    """Share of the reference that the axis may follow: what is configured, less while its amplifier is hot."""
    return p["authority"] * (p["watch"]["derate"] if s["watch"]["hot"] > 0 else 1.0)


@compiled
def move_setpoint(p: Record, s: Record, demand_um: float) -> bool:
    """Set-point inside the attainable range and the slew limit; False, and unmoved, if not finite.

    Where its voltage has to wait it goes no further (``waiting.py``).
    Where it starts outside the range (an actuator at rest) it stays until the demand leads it in: no jump.
    """
    if not math.isfinite(demand_um):
        return False
    step, before_um = p["setpoint_slew_um"], s["setpoint_um"]
    inside = attainable(p, s, demand_um)
    s["setpoint_um"] = no_further(s, before_um, max(before_um - step, min(before_um + step, inside)))
    return True


@compiled
def pid_gains(p: Record, s: Record) -> Record:
    """Those that act now: the fallback gains while anything swings or is away from its path, without a bump."""
    calm = int(s["watch"]["fallback"] != 0 or s["far"] > 0 or is_disturbed(s))
    gains = p["fallback"] if calm else p["pid"]
    if calm != s["calm"]:
        retune(p["pid"] if calm else p["fallback"], gains, s["pid"])
        s["calm"] = calm
    return gains


@compiled
def request_voltage(p: Record, s: Record, phase: int, fraction: float) -> float:
    """Feedforward plus feedback (V), before the limiter; no further where the device has yet to follow."""
    if p["mode"] == VOLTAGE:
        return s["setpoint_um"]
    feedforward = feedforward_voltage(p["hysteresis"], s["hysteresis"], s["setpoint_um"])
    if p["feedback"] == 0:
        if phase != CLOSED:
            s["pid"]["output_V"] = (1.0 - fraction) * s["pid"]["integrator"]
        else:  # what a feedback that was switched off leaves behind
            s["pid"]["output_V"] *= p["blend_decay"]
        s["strain_cycles"] = 0
    elif waits(s) or s["watch"]["coast"] > 0:
        s["strain_cycles"] = 0
    elif s["strain"]["fresh"]:
        saw_late(s, s["strain_cycles"] - p["pid"]["most_periods"])
        pid_output(pid_gains(p, s), s["pid"], s["strain_error_um"], s["strain_cycles"])
        s["strain_cycles"] = 0
    return no_further(s, s["voltage_V"], feedforward + s["pid"]["output_V"])


@compiled
def is_finite(p: Record, s: Record, phase: int) -> bool:
    """Whether every stage of the law is finite: estimate, feedforward, feedback and its memory, requested voltage.

    The inverse is looked at before its shaping function, whose limits would make a number of anything. With the outer
    loop closed the demand, which was finite, is a sum of all states of the estimate.
    """
    pid, inverse = s["pid"], s["hysteresis"]
    total = s["request_V"] + inverse["u_um"] + inverse["output_V"]
    total += pid["output_V"] + pid["integrator"] + pid["derivative"]
    if phase != CLOSED and p["mode"] == STAGE and s["estimator"]["running"] != 0:
        for i in range(p["outer"]["states"]):
            total += s["estimator"]["x"][i]
    return math.isfinite(total)


@compiled
def track_reference(p: Record, s: Record, now_ns: int, t_s: float, samples: Any) -> None:
    """Reference state w of this very moment, from the axis' own source or its signal; a known one also ahead of it."""
    if p["reference"]["kind"] == SIGNAL:
        signal_reference(p["reference"], s["reference"], now_ns)
    elif p["reference"]["kind"] == JOG:
        jog_reference(p["reference"], s["reference"], t_s >= 0.0)
        s["ahead_um"] = s["reference"]["w"][0]
    else:
        own_reference(p["reference"], s["reference"]["w"], t_s, samples)
        s["ahead_um"] = s["reference"]["w"][0]
        if s["preview_s"] > 0.0:
            s["ahead_um"] = previewed(p["reference"], s["reference"], t_s + s["preview_s"], samples)


@compiled
def start_axis(p: Record, s: Record) -> None:
    """Take the output over where it is: every memory agrees with the present voltage and position."""
    s["closed"] = 0
    s["frozen"] = 0
    s["estimator"]["running"] = 0
    forget_played(s["learned"])
    s["strain_cycles"] = 1
    s["far"] = s["near"] = s["relapses"] = s["calm"] = 0
    s["unseen"] = 0.0
    s["hold_scale"] = 1.0
    s["authority"] = authority(p, s)
    s["reference"]["jog_um"] = p["reference"]["target_um"]
    s["reference"]["jog_step_um"] = 0.0
    s["start_V"] = s["voltage_V"]
    s["start_um"] = s["voltage_V"] if p["mode"] == VOLTAGE else s["strain"]["value"]
    s["setpoint_um"] = s["start_um"]
    start_history(s)
    start_times(p, s)
    start_feedforward(p["hysteresis"], s["hysteresis"], s["setpoint_um"], s["voltage_V"])
    feedforward = feedforward_voltage(p["hysteresis"], s["hysteresis"], s["setpoint_um"])
    start_pid(p["pid"], s["pid"], 0.0, s["voltage_V"] - feedforward)
