"""Commands of the host: carried out at a cycle boundary, or refused with nothing changed."""

from __future__ import annotations

from .arming import plan_checks, refuse
from .axis_order import hold_here
from .bumpless import start_axis
from .faults import forget
from .jit import compiled
from .part import begin_part, end_part
from .phases import CLOSED
from .record import Record
from .shadow import promote, withdraw
from .states import (
    ARM,
    ARMING,
    BEGIN_PART,
    DISARM,
    END_PART,
    FAULT,
    HOLD,
    HOLDING,
    PROMOTE,
    READY,
    RESET,
    STOP,
    TRACKING,
    WITHDRAW,
)
from .transitions import begin_hold, begin_ramp, begin_soft_stop, enter


@compiled
def begin_arming(p: Record, s: Record) -> None:
    """Take every output over where it is, or go on after a hold."""
    s["resumed"] = 1 if s["state"] == HOLDING else 0
    if s["resumed"] == 0:
        plan_checks(p, s)
        for i in range(p["axes"]):
            s["order"][i]["start_V"] = s["axis"][i]["voltage_V"]
            start_axis(p["axis"][i], s["axis"][i])
    for i in range(p["axes"]):
        hold_here(s, i)
        figures = s["figures"][i]
        figures["error"] = figures["innovation"] = figures["feedback"] = 0.0
    enter(s, ARMING)


@compiled.rare
def apply_command(p: Record, s: Record, command: int) -> bool:
    """Carry out a command; False, and nothing changed, where the state or a sensor does not allow it."""
    state = s["state"]
    if command == ARM:
        if refuse(p, s):
            return False
        begin_arming(p, s)
    elif command == HOLD:
        if state == TRACKING or (state == ARMING and s["phase"] == CLOSED):
            begin_hold(p, s)
        elif state != HOLDING:
            return False
    elif command == DISARM:
        if state == TRACKING:
            begin_soft_stop(p, s)
        elif state in (ARMING, HOLDING):
            begin_ramp(p, s)
        elif state != READY:
            return False
    elif command == STOP:
        s["stopping"] = 1
        if state == TRACKING:
            begin_soft_stop(p, s)
        elif state in (ARMING, HOLDING):
            begin_ramp(p, s)
    elif command == PROMOTE:
        return promote(p, s)
    elif command == WITHDRAW:
        return withdraw(s)
    elif command == BEGIN_PART:
        if state != TRACKING or p["part"]["signal"] >= 0:
            return False
        begin_part(s, s["parts"] + 1)
    elif command == END_PART:
        if s["part"] == 0 or p["part"]["signal"] >= 0:
            return False
        end_part(s)
    elif command == RESET:
        at_rest = state == READY and p["amplifier_reset"] >= 0  # an amplifier's fault there is none of the cell's
        if (state != FAULT and not at_rest) or s["stopping"] != 0:
            return False
        if s["outputs_away"] != 0:  # READY says that everything rests at park
            return False
        s["reset_until_cycle"] = s["cycle"] + p["reset_cycles"]
        if state == FAULT:
            forget(p, s)
            enter(s, READY)
    return True
