"""One cycle of the whole cell: sensors, state machine, axes, outputs.

    OFF -> READY -> ARMED -> TRACKING        arm: lift to the working point, close, raise authority
             ^        |         |
             +--- RAMPING <-----+            disarm, stop, fault: smoothly to the park voltage
                    |
                    +--> OFF or FAULT        FAULT is latched until reset; nothing re-arms by itself

The same function runs in the 10 kHz loop and, in virtual time, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any

from .axis import CLOSED, LIFTING, PARKED, PARKING, axis_cycle, sample, start_axis
from .jit import compiled
from .records import Record
from .states import (
    ARM,
    ARMED,
    DISARM,
    FAULT,
    NO_COMMAND,
    NO_FAULT,
    NOT_FINITE,
    OFF,
    RAMPING,
    READY,
    RESET,
    STAGE,
    STAGE_INVALID,
    STOP,
    STRAIN_INVALID,
    TRACKING,
    VOLTAGE,
)


@compiled
def smooth(x: float) -> float:
    """Minimum-jerk course from 0 to 1 for x in 0..1 (speed and acceleration vanish at both ends)."""
    x = max(0.0, min(1.0, x))
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@compiled
def enter(s: Record, state: int) -> None:
    """Change the cell's state, and note when."""
    s["state"] = state
    s["entered_cycle"] = s["cycle"]


@compiled
def begin_ramp(p: Record, s: Record, after: int) -> None:
    """Start the smooth way to the park voltage of all axes; `after` is the state at its end.

    A ramp under way is not started anew; a fault or a stop during it changes where it ends. A stop counts for
    more than a fault, whichever came first: the fault stays latched, and the cell is OFF.
    """
    if s["state"] == RAMPING:
        if after == OFF or s["after_ramp"] == READY:
            s["after_ramp"] = after
        return
    for i in range(p["axes"]):
        s["axis"][i]["start_V"] = s["axis"][i]["voltage_V"]
    s["after_ramp"] = after
    enter(s, RAMPING)


@compiled
def raise_fault(p: Record, s: Record, fault: int, axis: int, value: float) -> None:
    """Latch `fault` (the first one stays) and ramp down; `axis` is -1 for the cell, `value` what was seen."""
    if s["fault"] == NO_FAULT:
        s["fault"] = fault
        s["fault_axis"] = axis
        s["fault_value"] = value
        s["fault_cycle"] = s["cycle"]
    if s["state"] == READY or s["state"] == OFF:
        enter(s, FAULT)
    elif s["state"] != FAULT:
        begin_ramp(p, s, FAULT)


@compiled
def sensor_fault(p: Record, a: Record, bad_samples: int, closed: bool) -> int:
    """Fault code of the axis' feedback sensors: unusable for `bad_samples` cycles in a row.

    The capacitive sensor counts once the outer loop is closed: at rest the stage may be out of its range.
    """
    if p["mode"] != VOLTAGE and a["strain"]["bad"] >= bad_samples:
        return STRAIN_INVALID
    if closed and p["mode"] == STAGE and a["stage"]["bad"] >= bad_samples:
        return STAGE_INVALID
    return NO_FAULT


@compiled
def apply_command(p: Record, s: Record, command: int) -> bool:
    """Carry out a command; False, and nothing changed, where the state or a sensor does not allow it."""
    state = s["state"]
    if command == ARM:
        if state != READY:
            return False
        for i in range(p["axes"]):
            if sensor_fault(p["axis"][i], s["axis"][i], 1, False) != NO_FAULT:
                return False
        for i in range(p["axes"]):
            start_axis(p["axis"][i], s["axis"][i])
        enter(s, ARMED)
    elif command == DISARM:
        if state in (ARMED, TRACKING):
            begin_ramp(p, s, READY)
        elif state != READY:
            return False
    elif command == STOP:
        if state in (READY, FAULT):
            enter(s, OFF)
        elif state != OFF:
            begin_ramp(p, s, OFF)
    elif command == RESET:
        if state != FAULT:
            return False
        s["fault"] = NO_FAULT
        enter(s, READY)
    return True


@compiled
def phase_of(p: Record, s: Record) -> tuple[int, float]:
    """What the axes do in this cycle, and how far they are with it (0..1)."""
    passed = float(s["cycle"] - s["entered_cycle"])
    if s["state"] == ARMED:
        if passed < p["lift_cycles"] + p["settle_cycles"]:
            return LIFTING, smooth(passed / p["lift_cycles"])
        return CLOSED, smooth((passed - p["lift_cycles"] - p["settle_cycles"]) / p["authority_cycles"])
    if s["state"] == TRACKING:
        return CLOSED, 1.0
    if s["state"] == RAMPING:
        return PARKING, smooth(passed / p["ramp_cycles"])
    return PARKED, 0.0


@compiled
def pass_missed(s: Record, missed: int) -> None:
    """Let `missed` cycles go by; arming and a ramp have waited where they were, so that they never jump."""
    s["cycle"] += missed
    if s["state"] == ARMED or s["state"] == RAMPING:
        s["entered_cycle"] += missed


@compiled
def is_parked(p: Record, s: Record) -> bool:
    """Whether every output gets to its park voltage within this cycle, however slow its slew limit is."""
    for i in range(p["axes"]):
        limiter = p["axis"][i]["limiter"]
        if abs(s["axis"][i]["voltage_V"] - limiter["park_V"]) > limiter["slew_V"]:
            return False
    return True


@compiled
def finish_phase(p: Record, s: Record) -> None:
    """Go on to the next state where arming or a ramp has come to its end."""
    passed = s["cycle"] - s["entered_cycle"]
    if s["state"] == ARMED and passed >= p["lift_cycles"] + p["settle_cycles"] + p["authority_cycles"]:
        s["tracking_cycle"] = s["cycle"]
        enter(s, TRACKING)
    elif s["state"] == RAMPING and passed >= p["ramp_cycles"] and is_parked(p, s):
        enter(s, s["after_ramp"])


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
        return a["reference"]["w"][0] - a["stage"]["value"], a["reference"]["w"][0]
    return math.nan, math.nan


@compiled
def cell_cycle(
    p: Record, s: Record, signals: Any, outputs: Any, samples: Any, command: int, now_ns: int, periods: int
) -> bool:
    """One cycle of all axes, `periods` after the one before; False where `command` was refused."""
    pass_missed(s, periods - 1)
    s["cycle"] += 1
    closed = phase_of(p, s)[0] == CLOSED
    for i in range(p["axes"]):
        sample(p["axis"][i], s["axis"][i], signals, now_ns)
        fault = sensor_fault(p["axis"][i], s["axis"][i], p["bad_samples"], closed)
        if fault != NO_FAULT and (s["state"] == ARMED or s["state"] == TRACKING):
            raise_fault(p, s, fault, i, float(p["bad_samples"]))
    accepted = command == NO_COMMAND or apply_command(p, s, command)
    finish_phase(p, s)
    phase, fraction = phase_of(p, s)
    tracked = s["cycle"] - s["tracking_cycle"] if s["state"] == TRACKING else -1
    t_s = tracked * p["period_ns"] * 1e-9
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        if not axis_cycle(axis, a, s["cycle"], now_ns, t_s, samples, phase, fraction):
            raise_fault(p, s, NOT_FINITE, i, a["setpoint_um"])
        outputs[axis["voltage"]] = a["voltage_V"]
        if tracked >= p["score_cycles"]:
            error, uncompensated = path_error(axis, a, signals)
            score(a, error, uncompensated)
    return accepted
