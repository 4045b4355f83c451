"""Commands of the host: carried out at a cycle boundary, or refused with nothing changed."""

from __future__ import annotations

from . import states
from .arming import plan_checks, refuse
from .axis import start_axis
from .axis_order import hold_here
from .digital_io import begin_part, end_part
from .faults import forget
from .jit import compiled
from .record import Record
from .shadow import promote, withdraw
from .states import CLOSED
from .transitions import begin_hold, begin_ramp, begin_soft_stop, enter


@compiled
def begin_arming(p: Record, s: Record) -> None:
    """Take every output over where it is, or go on after a hold."""
    s["resumed"] = 1 if s["state"] == states.HOLDING else 0
    if s["resumed"] == 0:
        plan_checks(p, s)
        for i in range(p["axes"]):
            s["order"][i]["start_V"] = s["axis"][i]["voltage_V"]
            start_axis(p["axis"][i], s["axis"][i])
    for i in range(p["axes"]):
        hold_here(s, i)
        figures = s["figures"][i]
        figures["error"] = figures["innovation"] = figures["feedback"] = 0.0
    enter(s, states.ARMING)


@compiled.rare
def apply_command(p: Record, s: Record, command: int) -> bool:
    """Carry out a command; False, and nothing changed, where the state or a sensor does not allow it."""
    state = s["state"]
    if command == states.ARM:
        if refuse(p, s):
            return False
        begin_arming(p, s)
    elif command == states.HOLD:
        if state == states.TRACKING or (state == states.ARMING and s["phase"] == CLOSED):
            begin_hold(p, s)
        elif state != states.HOLDING:
            return False
    elif command in (states.DISARM, states.STOP):
        if command == states.STOP:
            s["stopping"] = 1
        if state == states.TRACKING:
            begin_soft_stop(p, s)
        elif state in (states.ARMING, states.HOLDING):
            begin_ramp(p, s)
        elif state != states.READY:
            return command == states.STOP
    elif command == states.PROMOTE:
        return promote(p, s)
    elif command == states.WITHDRAW:
        return withdraw(s)
    elif command == states.BEGIN_PART:
        if state != states.TRACKING or p["part"]["signal"] >= 0:
            return False
        begin_part(s, s["parts"] + 1)
    elif command == states.END_PART:
        if s["part"] == 0 or p["part"]["signal"] >= 0:
            return False
        end_part(s)
    elif command == states.RESET:
        at_rest = state == states.READY and p["amplifier_reset"] >= 0  # the amplifier's own fault
        if (state != states.FAULT and not at_rest) or s["stopping"] != 0:
            return False
        if s["outputs_away"] != 0:  # READY says that everything rests at park
            return False
        s["reset_until_cycle"] = s["cycle"] + p["reset_cycles"]
        if state == states.FAULT:
            forget(p, s)
            enter(s, states.READY)
    return True
