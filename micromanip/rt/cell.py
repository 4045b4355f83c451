"""One cycle of the whole cell: sensors, what is watched, commands, states, axes, outputs.

The states and their changes are in ``transitions.py``, the sequence of arming in ``arming.py``, what is watched in
``watch.py`` and ``faults.py``. The same function runs in the 10 kHz loop and, in virtual time, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.decoupling import EASED, add_part, forget
from micromanip.rt.laws.digital_input import is_missing, is_on, read_line
from micromanip.rt.laws.motion import minimum_jerk

from . import states
from .arming import lift_fraction
from .axis import axis_cycle, measure
from .checks import advance_arming, keep_checks
from .commands import apply_command
from .digital_io import follow_part, follow_tool, is_enabled, switch
from .exchange import ALL_FOLLOW, FIRST_TAKEN
from .faults import axis_fault, cell_fault
from .figures import mean_squares, path_error, score
from .jit import compiled
from .record import Record
from .states import CLOSED, LIFTING, PARKED
from .supervisor import FOUND
from .transitions import finish_phase, phase_of, phase_of_axis
from .watch import watch_axis


@compiled
def watch_cell(p: Record, s: Record) -> None:
    """Look for faults wherever something may be moving."""
    state, moving = s["state"], is_enabled(s)
    closed = moving and not (state == states.RAMPING and s["soft"] == 0)
    rests = state == states.ARMING and s["phase"] == PARKED  # the amplifier may take its time to come on
    enabled = moving and not rests
    cell_fault(p, s, states.ENABLE_LOST, moving and is_missing(p["enable"], s["enable"]), 0.0, 1.0)
    cell_fault(p, s, states.INTERLOCK_OPEN, closed and is_missing(p["interlock"], s["interlock"]), 0.0, 1.0)
    for i in range(p["axes"]):
        watch_axis(p, s, i, closed, enabled)


@compiled
def watch_drivers(p: Record, s: Record, code: int) -> None:
    """Judge what the exchange of this cycle returned.

    A failure is a fault in any state, a link that is down in use. Outputs that do not follow the loop are one while the
    axes are moved by it: not before the first voltage of arming, and not on a ramp, which goes where they go too.
    """
    taken = ALL_FOLLOW < code <= FIRST_TAKEN
    s["link_down"] = 1 if FIRST_TAKEN < code < 0 else 0
    s["outputs_taken"] = 1 if taken else 0
    s["outputs_away"] = 1 if code != 0 else 0
    state = s["state"]
    parks = (state == states.RAMPING and s["soft"] == 0) or (state == states.ARMING and s["phase"] == PARKED)
    moves = is_enabled(s) and not parks
    cell_fault(p, s, states.DRIVER_ERROR, code > 0, float(code), 0.0)
    cell_fault(p, s, states.LINK_LOST, s["link_down"] != 0 and is_enabled(s), float(-1 - code), 0.0)
    cell_fault(p, s, states.OUTPUTS_TAKEN, taken and moves, float(FIRST_TAKEN - code), 0.0)


@compiled
def held_share(p: Record, s: Record, i: int) -> float:
    """What is left (0..1) of where axis `i` is held; in a hold for want of a reference it goes back to rest."""
    if s["state"] == states.RAMPING and p["axis"][i]["mode"] == states.STAGE:
        return 0.0
    if s["state"] != states.HOLDING or s["fault"] != states.REFERENCE_LOST:
        return 1.0
    passed = float(s["cycle"] - s["entered_cycle"])
    return 1.0 - minimum_jerk(passed / p["axis"][i]["watch"]["decay_cycles"])


@compiled
def give_orders(p: Record, s: Record, phase: int, fraction: float) -> None:
    """Tell each axis what the cell's state, the watch and the machine make of this cycle."""
    follows = s["state"] == states.TRACKING or (s["state"] == states.RAMPING and s["soft"] != 0)
    time_s = (s["cycle"] - s["tracking_cycle"] if follows else -1) * p["period_ns"] * 1e-9
    held = s["state"] == states.HOLDING
    for i in range(p["axes"]):
        axis, order, w = p["axis"][i], s["order"][i], s["watch"][i]
        order["phase"] = own = phase_of_axis(s, i, phase)
        order["level"] = minimum_jerk(lift_fraction(p, s, i, fraction)) if own == LIFTING else fraction
        order["missed"], order["time_s"] = s["missed"], time_s
        if s["state"] != states.ARMING:
            order["offset"] = 0.0
        order["reasons"] = w["raised"] & FOUND
        order["authority"] = axis["authority"] * (axis["watch"]["derate"] if w["hot"] > 0 else 1.0)
        order["held_share"] = held_share(p, s, i)
        order["followed"] = int(own == CLOSED and not held)
        order["may_move"] = int(held and s["fault"] == states.NO_FAULT and s["stopping"] == 0)
        order["part_begun"] = s["part_begun"] if s["part"] != 0 else -1
        order["other_tool"] = int(s["tool"] != p["learned_tool"])


@compiled
def decouple(p: Record, s: Record) -> None:
    """What the next set-point of each axis owes to the references of the others, as they were followed in this cycle.

    A frozen axis stays where it is, and so does what the others owe to it.
    """
    for i in range(p["axes"]):
        law, a = p["axis"][i]["decoupling"], s["axis"][i]
        own = a["decoupling"]
        if law["active"] == 0 and own["active"] == 0:
            continue
        if s["order"][i]["phase"] != CLOSED or a["estimator"]["running"] == 0:
            forget(own)
            continue
        own["active"], own["added_um"] = 0, 0.0
        for j in range(p["axes"]):
            w, follows = s["axis"][j]["reference"]["w"], s["order"][j]["phase"] == CLOSED
            add_part(law, own, j, EASED * p["axis"][i]["authority_step"], w, follows)


@compiled
def cell_cycle(p: Record, s: Record, signals: Any, outputs: Any, samples: Any, command: int, now_ns: int) -> bool:
    """The cycle of all axes that ``begin_cycle`` counted; False where `command` was refused."""
    for i in range(p["axes"]):
        measure(p["axis"][i], s["axis"][i], s["order"][i], signals, now_ns)
    read_line(p["enable"], s["enable"], signals, now_ns)
    read_line(p["interlock"], s["interlock"], signals, now_ns)
    read_line(p["retracted"], s["retracted"], signals, now_ns)
    watch_cell(p, s)
    accepted = command == states.NO_COMMAND or apply_command(p, s, command)
    finish_phase(p, s, is_on(p["retracted"], s["retracted"]))
    phase, fraction = advance_arming(p, s) if s["state"] == states.ARMING else phase_of(p, s)
    follow_part(p, s, signals, now_ns)
    follow_tool(p, s, signals, now_ns)
    s["phase"] = phase
    give_orders(p, s, phase, fraction)
    scored = s["state"] == states.TRACKING and s["cycle"] - s["tracking_cycle"] >= p["score_cycles"]
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        finite = axis_cycle(axis, a, s["order"][i], s["cycle"], now_ns, samples)
        axis_fault(p, s, i, states.NOT_FINITE, not finite, a["setpoint_um"], math.nan)
        outputs[axis["voltage"]] = a["voltage_V"]
        if scored:
            error, uncompensated = path_error(axis, a, signals)
            score(s["figures"][i], error, uncompensated)
        if s["state"] == states.TRACKING and axis["mode"] != states.VOLTAGE:
            mean_squares(p, axis, a, s["figures"][i])
    decouple(p, s)
    keep_checks(p, s)
    switch(p, s, outputs)
    return accepted
