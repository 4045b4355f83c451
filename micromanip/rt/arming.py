"""Arming: amplifier on, polarity and scale check, lift, decaying sweep, settling, authority 0 to 100 %.

The check makes a small step on one axis after the other and compares the response with the configuration: that of the
gauge to a voltage before an inner loop is closed, that of the stage to a set-point before an outer loop is. Each loop
is checked once, and again after anything that could have changed its response. The lift begins on one axis after the
other, which shows whether every gauge follows its own voltage. The sweep erases the hysteresis memory of actuator and
model: a play operator whose input swings by more than its threshold forgets its history. Refused arming gives its
reasons as bits.
"""

from __future__ import annotations

import math

from micromanip.rt.laws.move import minimum_jerk
from micromanip.rt.laws.reference import SIGNAL
from micromanip.rt.laws.sensor import is_silent, may_be_at_end

from . import states
from .digital_io import is_missing
from .jit import compiled
from .record import Record, record
from .states import CHECKING_GAUGE, CHECKING_STAGE, CLOSED, LIFTING, PARKED, SWEEPING

CHECK_PARAMETERS = record(
    ("step", "f8"), ("low", "f8"), ("high", "f8"), ("slack", "f8"), ("slack_cycles", "i8"), ("lag_step", "f8")
)
"""Polarity and scale check: height of the step, and between what the answer to it must lie; by how much, and how
long, a gauge may stray during the lift, and the share of a voltage's change that it shows a cycle later."""
CHECK_STATE = record(
    ("before", "f8"),
    ("after", "f8"),
    ("before_samples", "i8"),
    ("after_samples", "i8"),
    ("turn", "i8"),
    ("found", "f8"),
    ("passed", "i8"),
    ("shown_V", "f8"),
    ("outside", "i8"),
)
"""What a check gathers; its place among the axes that are checked in this arming (1 is the first, 0: it is not due);
what it found last, and whether that was as expected and still counts. During the lift: the voltage that the gauge shows
at least, and for how many cycles it has not fitted."""
ARMING_STATE = record(
    ("refused", "i8"),
    ("lift_turn", "i8"),
    ("lifted", "i8"),
    ("check", CHECK_STATE, (2,)),
)
"""Of an axis: why arming was refused; its place in the lift, and whether that has come; its checks."""
OF_GAUGE, OF_STAGE = range(2)
"""The check of the inner loop, and that of the outer one."""
_COURSE = (PARKED, CHECKING_GAUGE, LIFTING, CHECKING_STAGE, SWEEPING, LIFTING)
"""What the axes do until all are at their working points, and stay there until they have settled."""
_SHOWS = 3.0
"""A lift that is so many times as far as its gauge may stray shows whether the gauge follows the voltage."""


@compiled
def refuse(p: Record, s: Record) -> bool:
    """Note in ``refused`` of the cell and of each axis why it can't be armed now; True where there is a reason."""
    resuming = s["state"] == states.HOLDING
    reasons = _if(states.NOT_READY, s["state"] != states.READY and not resuming)
    reasons |= _if(states.LATCHED, s["fault"] != states.NO_FAULT or s["stopping"] != 0)
    reasons |= _if(states.ENABLE_MISSING, is_missing(p["enable"], s["enable"]))
    reasons |= _if(states.INTERLOCK_MISSING, is_missing(p["interlock"], s["interlock"]))
    reasons |= _if(states.LINK_MISSING, s["link_down"] != 0)
    reasons |= _if(states.OUTPUTS_MISSING, s["outputs_taken"] != 0)
    s["refused"] = reasons
    for i in range(p["axes"]):
        axis, a, limits = p["axis"][i], s["axis"][i], p["axis"][i]["watch"]
        strain, reference = a["strain"], a["reference"]
        lost = strain["bad"] > 0 or strain["identical"] >= limits["strain_identical"]
        late = reference["time_ns"] == 0 or reference["silent"] >= limits["stale_cycles"]
        away = axis["mode"] == states.STAGE and stage_loss(axis, a, 1, resuming) != states.NO_FAULT
        refused = _if(states.STRAIN_MISSING, axis["mode"] != states.VOLTAGE and lost)
        refused |= _if(states.STAGE_MISSING, away)
        refused |= _if(states.REFERENCE_MISSING, axis["reference"]["kind"] == SIGNAL and late)
        refused |= _if(states.AMPLIFIER_MISSING, is_missing(axis["amplifier_ok"], a["amplifier_ok"]))
        refused |= _if(states.TEMPERATURE_MISSING, is_missing(axis["temperature_ok"], a["temperature_ok"]))
        refused |= _if(states.NOT_RESUMABLE, resuming and s["watch"][i]["frozen"] != 0)
        s["arming"][i]["refused"] = refused
        reasons |= refused
    return reasons != 0


@compiled
def _if(bit: int, found: bool) -> int:
    return bit if found else 0


@compiled
def stage_loss(axis: Record, a: Record, samples: int, usable: bool) -> int:
    """The fault that the capacitive sensor of an axis in mode stage would be to arming, or NO_FAULT.

    It must send samples, and not be unusable for `samples` cycles. At rest the stage may be at an end of its range,
    where samples may be flagged or identical; both are excused unless the sensor must be `usable`.
    """
    sensor = a["stage"]
    excused = not usable and may_be_at_end(sensor, axis["stage_range_um"])
    longest_ns = axis["stage_age_ns"] + int(samples / axis["cycles_per_ns"])
    if is_silent(sensor, longest_ns) or (sensor["bad"] >= samples and not excused):
        return states.STAGE_INVALID
    stuck = usable and sensor["identical"] >= axis["watch"]["stage_identical"]
    return states.STAGE_STUCK if stuck else states.NO_FAULT


@compiled
def plan_checks(p: Record, s: Record) -> None:
    """Give each loop that is to be closed, and whose check does not count (any more), its turn in this arming."""
    s["checks"][OF_GAUGE] = s["checks"][OF_STAGE] = s["lifts"] = 0
    for i in range(p["axes"]):
        axis, own = p["axis"][i], s["arming"][i]
        mode, own["lifted"], own["lift_turn"] = axis["mode"], 0, 0
        start_check(own["check"][OF_GAUGE])
        start_check(own["check"][OF_STAGE])
        if p["check_cycles"] == 0 or mode == states.VOLTAGE:
            continue
        own["lift_turn"] = s["lifts"]
        s["lifts"] += 1
        far_um = abs(lift_target(axis, s["axis"][i]) - s["axis"][i]["strain"]["value"])
        if far_um < _SHOWS * axis["check"][OF_GAUGE]["slack"]:
            own["check"][OF_GAUGE]["passed"] = 0
        for kind in range(2 if mode == states.STAGE else 1):
            if own["check"][kind]["passed"] == 0:
                s["checks"][kind] += 1
                own["check"][kind]["turn"] = s["checks"][kind]


@compiled
def lift_target(axis: Record, a: Record) -> float:
    """Where a lift ends: the working point, or where the axis' own reference begins."""
    follows = axis["mode"] == states.STAGE or axis["reference"]["kind"] == SIGNAL
    return axis["centre_um"] if follows else a["reference"]["ahead_um"]


@compiled
def lifting_cycles(p: Record, s: Record) -> int:
    """Length of the lift of all axes, each of which begins a turn after the one before."""
    return p["lift_cycles"] + p["lift_turn_cycles"] * max(0, s["lifts"] - 1)


@compiled
def lift_fraction(p: Record, s: Record, i: int, place: float) -> float:
    """How far (0..1) axis `i` is at `place` (0..1) of the lift of all; below 0 before its turn."""
    return (place * lifting_cycles(p, s) - s["arming"][i]["lift_turn"] * p["lift_turn_cycles"]) / p["lift_cycles"]


@compiled
def planned_cycles(p: Record, s: Record) -> int:
    """Length of an arming that began now, at rest."""
    s["resumed"] = 0
    plan_checks(p, s)
    return arming_cycles(p, s)


@compiled
def course(p: Record, s: Record) -> tuple[int, int, int, int, int, int]:
    """How many cycles each part of ``_COURSE`` takes, as it was planned."""
    gauges, stages = p["check_cycles"] * s["checks"][OF_GAUGE], p["check_cycles"] * s["checks"][OF_STAGE]
    return p["enable_cycles"], gauges, lifting_cycles(p, s), stages, p["sweep_cycles"], p["settle_cycles"]


@compiled
def arming_cycles(p: Record, s: Record) -> int:
    """Length of the whole sequence as planned; what resumes a hold needs only its authority back."""
    return p["authority_cycles"] + (sum(course(p, s)) if s["resumed"] == 0 else 0)


@compiled
def arming_phase(p: Record, s: Record, passed: float) -> tuple[int, float]:
    """What the axes do so many cycles after arming began, and how far they are with it (0..1)."""
    if s["resumed"] == 0:
        cycles = course(p, s)
        for k in range(len(_COURSE)):
            if passed < cycles[k]:
                settles = k == len(_COURSE) - 1
                return _COURSE[k], 1.0 if settles else passed / cycles[k] if k > 0 else 0.0
            passed -= cycles[k]
    return CLOSED, minimum_jerk(passed / p["authority_cycles"])


@compiled
def check_step(place: float) -> float:
    """Course of one axis' step (0..1) for `place` 0..1: rest, up, rest, down, a quarter each."""
    return minimum_jerk(4.0 * place - 1.0) - minimum_jerk(4.0 * place - 3.0)


@compiled
def gather(c: Record, place: float, value: float) -> None:
    """Average the sensor's value where it is at rest before the step, and at rest on it."""
    if 0.125 <= place < 0.25:
        c["before"] += value
        c["before_samples"] += 1
    elif 0.625 <= place < 0.75:
        c["after"] += value
        c["after_samples"] += 1


@compiled
def answer(c: Record, step: float) -> float:
    """What the sensor answered to the step, per unit of it; NaN before both averages are there."""
    if c["before_samples"] == 0 or c["after_samples"] == 0:
        return math.nan
    return (c["after"] / c["after_samples"] - c["before"] / c["before_samples"]) / step


@compiled
def sweep_offset(p: Record, axis: Record, target_um: float, fraction: float) -> float:
    """Decaying sweep around `target_um` at `fraction` of its time: faded in over half a turn, inside the range."""
    room = min(target_um - axis["setpoint_low_um"], axis["setpoint_high_um"] - target_um)
    amplitude = max(0.0, min(axis["sweep_um"], room))
    turns = p["sweep_turns"] * fraction
    return amplitude * minimum_jerk(2.0 * turns) * (1.0 - fraction) * math.sin(2.0 * math.pi * turns)


@compiled
def start_check(c: Record) -> None:
    """Discard the averages of an earlier check; its result still counts."""
    c["before"] = c["after"] = 0.0
    c["before_samples"] = c["after_samples"] = 0
    c["turn"] = 0


@compiled
def judge(c: Record, limits: Record, found: float) -> bool:
    """Store what a check found, and whether it is as expected."""
    c["found"] = found
    c["passed"] = 1 if limits["low"] <= found <= limits["high"] else 0
    return c["passed"] != 0


@compiled
def forget_checks(a: Record, first: int) -> None:
    """The loops of an axis must be checked before they are closed again: both, or the outer one where that is `first`.

    The answer of the stage is one to a set-point that the gauge measures.
    """
    for kind in range(first, 2):
        a["check"][kind]["passed"] = 0


@compiled
def carry_checks(old: Record, new: Record, a: Record) -> None:
    """Under new parameters of an axis: other signals, outputs or another mode are checked anew, other limits judged."""
    was, now = old["limiter"], new["limiter"]
    others = old["mode"] != new["mode"] or old["strain"] != new["strain"] or old["stage"] != new["stage"]
    others = others or old["voltage"] != new["voltage"] or was["low_V"] != now["low_V"]
    if others or was["high_V"] != now["high_V"] or was["slew_V"] != now["slew_V"] or was["park_V"] != now["park_V"]:
        forget_checks(a, OF_GAUGE)
    for kind in range(2):
        c = a["check"][kind]
        if c["passed"] != 0 and not judge(c, new["check"][kind], c["found"]):
            forget_checks(a, kind)
