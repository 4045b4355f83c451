"""One cycle of the whole cell: sensors, what is watched, commands, states, axes, outputs.

The states and their changes are in ``transitions.py``, the sequence of arming in ``arming.py``, what is watched in
``watch.py`` and ``faults.py``. The same function runs in the 10 kHz loop and, in virtual time, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any

from .arming import answer, check_step, gather, refuse, start_check, sweep_offset
from .axis import axis_cycle, sample, start_axis
from .course import smooth
from .faults import axis_fault, cell_fault, forget
from .jit import compiled
from .phases import BUMPING, CLOSED, LIFTING, PARKED, PROBING, SWEEPING
from .records import Record
from .reference import SIGNAL
from .sensor import is_missing, is_on, read_line
from .shadow import promote, withdraw
from .states import (
    ARM,
    ARMED,
    DISARM,
    ENABLE_LOST,
    FAULT,
    HOLD,
    HOLDING,
    INTERLOCK_OPEN,
    NO_COMMAND,
    NO_FAULT,
    NOT_FINITE,
    PROMOTE,
    RAMPING,
    READY,
    REFERENCE_LOST,
    RESET,
    STAGE,
    STAGE_CHECK,
    STOP,
    STRAIN_CHECK,
    TRACKING,
    VOLTAGE,
    WITHDRAW,
)
from .transitions import (
    begin_hold,
    begin_ramp,
    begin_soft_stop,
    enter,
    finish_phase,
    pass_missed,
    phase_of,
    phase_of_axis,
)
from .watch import following_error, watch_axis


@compiled
def read_lines(p: Record, s: Record, signals: Any, now_ns: int) -> None:
    """Digital inputs of the cell."""
    read_line(p["enable"], s["enable"], signals, now_ns)
    read_line(p["interlock"], s["interlock"], signals, now_ns)
    read_line(p["retracted"], s["retracted"], signals, now_ns)


@compiled
def watch_cell(p: Record, s: Record) -> None:
    """Look for faults wherever something may be moving."""
    state = s["state"]
    moving = state in (ARMED, TRACKING, HOLDING, RAMPING)
    closed = moving and not (state == RAMPING and s["soft"] == 0)
    enabled = moving and not (state == ARMED and s["phase"] == PARKED)  # the amplifier may take its time to come on
    cell_fault(p, s, ENABLE_LOST, moving and is_missing(p["enable"], s["enable"]), 0.0, 1.0)
    cell_fault(p, s, INTERLOCK_OPEN, closed and is_missing(p["interlock"], s["interlock"]), 0.0, 1.0)
    for i in range(p["axes"]):
        watch_axis(p, s, i, closed, enabled)


@compiled
def begin_arming(p: Record, s: Record) -> None:
    """Take every output over where it is, or go on after a hold."""
    s["resumed"] = 1 if s["state"] == HOLDING else 0
    if s["resumed"] == 0:
        for i in range(p["axes"]):
            start_axis(p["axis"][i], s["axis"][i])
            start_check(s["axis"][i]["strain_check"])
            start_check(s["axis"][i]["stage_check"])
    for i in range(p["axes"]):
        s["axis"][i]["closed"] = 0
    enter(s, ARMED)


@compiled
def apply_command(p: Record, s: Record, command: int) -> bool:
    """Carry out a command; False, and nothing changed, where the state or a sensor does not allow it."""
    state = s["state"]
    if command == ARM:
        if refuse(p, s):
            return False
        begin_arming(p, s)
    elif command == HOLD:
        if state == TRACKING or (state == ARMED and s["phase"] == CLOSED):
            begin_hold(p, s)
        elif state != HOLDING:
            return False
    elif command == DISARM:
        if state == TRACKING:
            begin_soft_stop(p, s)
        elif state in (ARMED, HOLDING):
            begin_ramp(p, s)
        elif state != READY:
            return False
    elif command == STOP:
        s["stopping"] = 1
        if state == TRACKING:
            begin_soft_stop(p, s)
        elif state in (ARMED, HOLDING):
            begin_ramp(p, s)
    elif command == PROMOTE:
        return promote(p, s)
    elif command == WITHDRAW:
        return withdraw(s)
    elif command == RESET:
        if state != FAULT or s["stopping"] != 0:
            return False
        forget(p, s)
        enter(s, READY)
    return True


@compiled
def arming_step(p: Record, s: Record, phase: int, fraction: float) -> float:
    """Offsets of the axes in a check or a sweep, and the verdict of a check; the fraction that the axes get.

    In a check the axes have their turn one after the other, `fraction` is the place in all of them together.
    """
    checking = phase in (PROBING, BUMPING)
    place = fraction * p["axes"] if checking else 0.0
    turn = int(place)
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        if phase == LIFTING and (s["phase"] == PARKED or s["phase"] == PROBING):
            start_axis(axis, a)
        a["offset"] = 0.0
        if phase == SWEEPING and axis["mode"] != VOLTAGE:
            follows = axis["mode"] == STAGE or axis["reference"]["kind"] == SIGNAL
            target_um = axis["centre_um"] if follows else a["reference"]["w"][0]
            a["offset"] = sweep_offset(p, axis, target_um, fraction)
        if i != turn or not checking:
            continue
        if phase == PROBING and axis["mode"] != VOLTAGE:
            a["offset"] = axis["strain_check"]["step"] * check_step(place - turn)
            gather(a["strain_check"], place - turn, a["strain"]["value"])
        elif phase == BUMPING and axis["mode"] == STAGE:
            a["offset"] = axis["stage_check"]["step"] * check_step(place - turn)
            gather(a["stage_check"], place - turn, a["stage"]["value"])
    return 1.0 if checking or phase == SWEEPING else fraction


@compiled
def judge_checks(p: Record, s: Record, phase: int) -> None:
    """Where a polarity and scale check has ended: every answer inside what is expected, or a fault."""
    was = s["phase"]
    if s["state"] != ARMED or s["checked"] != 0 or phase == was:
        return
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        code, limits, c = STRAIN_CHECK, axis["strain_check"], a["strain_check"]
        if was == BUMPING:
            code, limits, c = STAGE_CHECK, axis["stage_check"], a["stage_check"]
        checked = axis["mode"] == STAGE or (was == PROBING and axis["mode"] != VOLTAGE)
        if checked and (was in (PROBING, BUMPING)):
            found = answer(c, limits["step"])
            good = limits["low"] <= found <= limits["high"]
            axis_fault(p, s, i, code, not good, found, limits["high"] if found > limits["high"] else limits["low"])
    if was == BUMPING and s["state"] == ARMED:
        s["checked"] = 1
        s["entered_cycle"] += 2 * p["check_cycles"] * p["axes"]  # what lies behind is no part of the sequence any more


@compiled
def decay_hold(p: Record, s: Record) -> None:
    """In a hold for want of a reference the axes go back to their working points."""
    decays = s["state"] == HOLDING and s["fault"] == REFERENCE_LOST
    passed = float(s["cycle"] - s["entered_cycle"])
    for i in range(p["axes"]):
        s["axis"][i]["hold_scale"] = 1.0 - smooth(passed / p["decay_cycles"]) if decays else 1.0


@compiled
def switch(p: Record, s: Record, outputs: Any) -> None:
    """Digital outputs: amplifier on, feed-hold asked of the machine, heartbeat of the loop."""
    if p["amplifier_enable"] >= 0:
        outputs[p["amplifier_enable"]] = 1.0 if is_enabled(s) else 0.0
    if p["feed_hold"] >= 0:
        outputs[p["feed_hold"]] = 1.0 if asks_feed_hold(s) else 0.0
    if p["heartbeat"] >= 0:
        outputs[p["heartbeat"]] = float(s["cycle"] // p["heartbeat_cycles"] % 2)


@compiled
def is_enabled(s: Record) -> bool:
    """Whether the amplifier is asked to be on."""
    state = s["state"]
    return state in (ARMED, TRACKING, HOLDING, RAMPING)


@compiled
def asks_feed_hold(s: Record) -> bool:
    """Whether the machine is asked to stop feeding: the path is not corrected, or not for long."""
    return s["state"] == HOLDING or s["fault"] != NO_FAULT


@compiled
def score(a: Record, path_error_um: float, uncompensated_um: float) -> None:
    """Add one cycle to the running figures of the path error."""
    a["errors"] += 1
    a["error_squares"] += path_error_um * path_error_um
    a["error_max"] = max(a["error_max"], abs(path_error_um))
    a["uncompensated_squares"] += uncompensated_um * uncompensated_um


@compiled
def path_error(p: Record, a: Record, signals: Any) -> tuple[float, float]:
    """Error at the spindle with and without compensation: the simulation's truth, else as measured."""
    if p["path_error"] >= 0:
        return signals[p["path_error"]]["value"], signals[p["uncompensated"]]["value"]
    if p["mode"] == STAGE:
        reference_um = a["reference"]["w"][0] + a["reference"]["w"][3]
        return reference_um - a["stage"]["value"], reference_um
    return math.nan, math.nan


@compiled
def mean_squares(p: Record, axis: Record, a: Record) -> None:
    """Carry the figures of merit of an axis on."""
    figures = a["figures"]
    error_um = following_error(axis, a)
    added_V = a["voltage_V"] - a["hysteresis"]["output_V"]
    step = p["figures_step"]
    figures["error"] += step * (error_um * error_um - figures["error"])
    figures["innovation"] += step * (a["estimator"]["innovation_um"] ** 2 - figures["innovation"])
    figures["feedback"] += step * (added_V * added_V - figures["feedback"])


@compiled
def cell_cycle(
    p: Record, s: Record, signals: Any, outputs: Any, samples: Any, command: int, now_ns: int, periods: int
) -> bool:
    """One cycle of all axes, `periods` after the one before; False where `command` was refused."""
    pass_missed(s, periods - 1)
    s["cycle"] += 1
    for i in range(p["axes"]):
        sample(p["axis"][i], s["axis"][i], signals, now_ns)
    read_lines(p, s, signals, now_ns)
    watch_cell(p, s)
    accepted = command == NO_COMMAND or apply_command(p, s, command)
    finish_phase(p, s, is_on(p["retracted"], s["retracted"]))
    phase, fraction = phase_of(p, s)
    if s["state"] == ARMED:
        judge_checks(p, s, phase)
        phase, fraction = phase_of(p, s)
        fraction = arming_step(p, s, phase, fraction)
    decay_hold(p, s)
    s["phase"] = phase
    follows = s["state"] == TRACKING or (s["state"] == RAMPING and s["soft"] != 0)
    tracked = s["cycle"] - s["tracking_cycle"] if follows else -1
    t_s = tracked * p["period_ns"] * 1e-9
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        own = phase_of_axis(s, a, phase)
        finite = axis_cycle(axis, a, s["cycle"], now_ns, t_s, samples, own, fraction)
        axis_fault(p, s, i, NOT_FINITE, not finite, a["setpoint_um"], math.nan)
        outputs[axis["voltage"]] = a["voltage_V"]
        if s["state"] == TRACKING and tracked >= p["score_cycles"]:
            error, uncompensated = path_error(axis, a, signals)
            score(a, error, uncompensated)
        if s["state"] == TRACKING and axis["mode"] != VOLTAGE:
            mean_squares(p, axis, a)
    switch(p, s, outputs)
    return accepted
