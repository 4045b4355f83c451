"""THE hot path: one cycle of one axis; its start, and its change to other parameters.

measure -> supervise -> estimate (Kalman) -> reference -> set-point (LQG) -> voltage: inverse hysteresis
(feedforward) + PID on the strain gauge (feedback) -> limiter -> telemetry

Neither start nor change makes an output jump. At a start every memory agrees with the present voltage and position.
Under new parameters every state that still counts is kept: the PID's integrator takes up what another gain or another
inverse model would have changed, and the outer loop's set-point is led over from where it is.

Budget: three axes with 6 plays and 11 states take about 1-2 us of the 100 us period (`micromanip
system bench` measures it beside a C twin). Nothing here allocates, raises or calls Python.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.estimator import change_model, follow_stage, remember
from micromanip.rt.laws.excitation import excitation
from micromanip.rt.laws.feedforward import feedforward_voltage, start_feedforward
from micromanip.rt.laws.learned import add_learned, forget_played
from micromanip.rt.laws.move import advance_move
from micromanip.rt.laws.pid import pid_output, retune, start_pid, unwind
from micromanip.rt.laws.reference import change_modes, reference_now, signal_sample
from micromanip.rt.laws.saturation import hold_back, limit
from micromanip.rt.laws.sensor import read_sensor

from .digital_io import read_line
from .errors import ease_times, measure_errors, move_setpoint, remember_setpoint, start_history
from .jit import compiled
from .record import Record
from .reference_blend import blend_state, blended, blended_position, hold_anew, start_blend
from .states import CHECKING_GAUGE, CLOSED, DRIVEN, FROZEN, PARKING, STAGE, VOLTAGE
from .supervisor import STAGE_LOST, gains_of, inner_gains, is_steady, outer_demand, start_supervisor, supervise

_ANY_UM = (-math.inf, math.inf)


@compiled
def measure(p: Record, s: Record, order: Record, signals: Record, now_ns: int) -> None:
    """Take the axis' signals from the process image."""
    s["reference"]["silent"] += 1
    strain_rate, stage_rate, deviation = p["strain_rate_um_per_ns"], p["stage_rate_um_per_ns"], s["deviation"]
    read_sensor(p["strain"], signals, s["strain"], now_ns, p["strain_age_ns"], p["strain_range_um"], strain_rate)
    read_sensor(p["stage"], signals, s["stage"], now_ns, p["stage_age_ns"], p["stage_range_um"], stage_rate)
    if read_sensor(p["deviation"], signals, deviation, now_ns, p["reference_age_ns"], _ANY_UM, math.inf):
        followed = order["followed"] != 0
        signal_sample(p["reference"], s["reference"], deviation["value"], deviation["time_ns"], followed)
    read_line(p["amplifier_ok"], s["amplifier_ok"], signals, now_ns)
    read_line(p["temperature_ok"], s["temperature_ok"], signals, now_ns)


@compiled.called
def axis_cycle(p: Record, s: Record, order: Record, cycle: int, now_ns: int, samples: Any) -> bool:
    """Advance the axis by one cycle, as the cell orders; False where any stage of its law gave no finite number.

    The set-point and the voltage before that stay then. `samples` are those of the own source.
    """
    supervise(p, s, order)
    steady = is_steady(s, order)
    moves = steady and order["may_move"] != 0 and (p["mode"] != STAGE or s["estimator"]["running"] != 0)
    advance_move(p["move"], s["move"], cycle, moves)
    if order["phase"] not in DRIVEN:
        measure_errors(p, s, cycle)
        return rest(p, s, order)
    if p["mode"] == STAGE:
        given_um = s["setpoint_um"] - p["centre_um"] - s["added_um"]
        usable = s["supervisor"]["reasons"] & STAGE_LOST == 0
        follow_stage(p["outer"], s["estimator"], s["stage"], given_um, cycle, p["cycles_per_ns"], usable)
    ease_times(p, s)
    reference_now(p["reference"], s["reference"], s["preview_s"], now_ns, order["time_s"], samples)
    follows = steady and order["level"] == 1.0
    add_learned(p["learned"], s["learned"], order, s["reference"]["w"], samples, cycle, follows)
    added_um = excitation(p["excitation"], s["excitation"], cycle, steady)
    finite = move_setpoint(p, s, order["behind"], demand(p, s, order) + added_um)
    remember_setpoint(s, cycle)
    measure_errors(p, s, cycle)
    s["request_V"] = request_voltage(p, s, order)
    finite = finite and is_finite(p, s, order["phase"])
    s["voltage_V"] = limit(p["limiter"], s["voltage_V"], s["request_V"], True)
    unwind(p["pid"], s["pid"], s["request_V"] - s["voltage_V"])
    remember(s["estimator"], s["setpoint_um"] - p["centre_um"] - s["added_um"])
    return finite


@compiled
def rest(p: Record, s: Record, order: Record) -> bool:
    """Voltage of an axis without its loops: parked, on a ramp to there, frozen, or with the step of a check."""
    s["request_V"] = blended(order["start_V"], p["limiter"]["park_V"], order["level"]) + order["offset"]
    if order["phase"] == FROZEN:
        s["request_V"] = s["voltage_V"]
    permitted = order["phase"] in (PARKING, CHECKING_GAUGE, FROZEN)
    s["voltage_V"] = limit(p["limiter"], s["voltage_V"], s["request_V"], permitted)
    return math.isfinite(s["request_V"])


@compiled
def demand(p: Record, s: Record, order: Record) -> float:
    """What the set-point should be, before its limits: um, or V in the open-loop mode.

    Without an estimate that runs there is no outer loop: the set-point stays.
    """
    b, step = s["blend"], p["authority_step"]
    b["authority"] += max(-step, min(step, order["authority"] - b["authority"]))
    if p["mode"] != STAGE or order["phase"] != CLOSED:
        return blended_position(p, s, order)
    if s["estimator"]["running"] == 0:
        return s["setpoint_um"]
    anew = hold_anew(p, s, order)
    blend_state(p, s, order)
    return outer_demand(p, s, anew)


@compiled
def request_voltage(p: Record, s: Record, order: Record) -> float:
    """Feedforward plus feedback (V), before the limiter; no further where the device is behind."""
    if p["mode"] == VOLTAGE:
        return s["setpoint_um"]
    feedforward = feedforward_voltage(p["hysteresis"], s["hysteresis"], s["setpoint_um"])
    pid, periods = s["pid"], s["supervisor"]["step"]
    if periods > 0:
        pid_output(inner_gains(p, s), pid, s["strain_error_um"], periods)
    elif p["feedback"] == 0:  # what a feedback that was switched off leaves behind
        lifts = order["phase"] != CLOSED
        pid["output_V"] = (1.0 - order["level"]) * pid["integrator"] if lifts else pid["output_V"] * p["blend_decay"]
    return hold_back(order["behind"], s["voltage_V"], feedforward + pid["output_V"])


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


@compiled.rare
def start_axis(p: Record, s: Record) -> None:
    """Take the output over where it is."""
    start_um = s["voltage_V"] if p["mode"] == VOLTAGE else s["strain"]["value"]
    s["estimator"]["running"] = 0
    forget_played(s["learned"])
    start_supervisor(s["supervisor"])
    s["reference"]["jog_um"], s["reference"]["jog_step_um"] = p["reference"]["target_um"], 0.0
    start_blend(p, s["blend"], start_um)
    s["setpoint_um"] = start_um
    start_history(p, s)
    start_feedforward(p["hysteresis"], s["hysteresis"], start_um, s["voltage_V"])
    feedforward = feedforward_voltage(p["hysteresis"], s["hysteresis"], start_um)
    start_pid(p["pid"], s["pid"], 0.0, s["voltage_V"] - feedforward)


@compiled
def change_axis(old: Record, new: Record, s: Record) -> None:
    """Carry the state `s` of one axis over from parameters `old` to `new`."""
    if old["feedback"] == 0 and new["feedback"] != 0:
        start_pid(new["pid"], s["pid"], s["strain_error_um"], s["pid"]["output_V"])
    else:
        retune(gains_of(old, s["supervisor"]["gain_set"]), new["pid"], s["pid"])
    if old["hysteresis"]["identity"] != new["hysteresis"]["identity"]:
        before = s["hysteresis"]["output_V"]
        start_feedforward(new["hysteresis"], s["hysteresis"], s["setpoint_um"], s["voltage_V"])
        after = feedforward_voltage(new["hysteresis"], s["hysteresis"], s["setpoint_um"])
        s["pid"]["integrator"] += before - after
        s["pid"]["output_V"] += before - after
    change_model(old["outer"], new["outer"], s["estimator"])
    change_modes(old["reference"], new["reference"], s["reference"])
    if new["mode"] != STAGE:
        s["estimator"]["running"] = 0
    s["supervisor"]["gain_set"] = 0
    s["blend"]["held_since"] = -1
