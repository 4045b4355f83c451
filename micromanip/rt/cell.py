"""One cycle of the whole cell: sensors, what is watched, commands, states, axes, outputs.

The states and their changes are in ``transitions.py``, the sequence of arming in ``arming.py``, what is watched in
``watch.py`` and ``faults.py``. The same function runs in the 10 kHz loop and, in virtual time, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.decoupling import EASED, answer, ease_share, forget
from micromanip.rt.laws.minimum_jerk import minimum_jerk
from micromanip.rt.laws.sensor import is_missing, is_on

from .arming import lift_fraction
from .axis import axis_cycle, sample
from .checks import arming_step, judge_checks, keep_checks, watch_arming, watch_lift
from .commands import apply_command
from .digital_io import is_enabled, read_lines, switch
from .exchange import ALL_FOLLOW, FIRST_TAKEN
from .faults import axis_fault, cell_fault
from .figures import mean_squares, path_error, score
from .jit import compiled
from .part import follow_part, follow_tool
from .phases import CLOSED, LIFTING, PARKED
from .record import Record
from .states import (
    ARMING,
    DRIVER_ERROR,
    ENABLE_LOST,
    HOLDING,
    INTERLOCK_OPEN,
    LINK_LOST,
    NO_COMMAND,
    NO_FAULT,
    NOT_FINITE,
    OUTPUTS_TAKEN,
    RAMPING,
    REFERENCE_LOST,
    TRACKING,
    VOLTAGE,
)
from .transitions import finish_phase, phase_of, phase_of_axis
from .watch import watch_axis


@compiled
def watch_cell(p: Record, s: Record) -> None:
    """Look for faults wherever something may be moving."""
    state, moving = s["state"], is_enabled(s)
    closed = moving and not (state == RAMPING and s["soft"] == 0)
    enabled = moving and not (state == ARMING and s["phase"] == PARKED)  # the amplifier may take its time to come on
    cell_fault(p, s, ENABLE_LOST, moving and is_missing(p["enable"], s["enable"]), 0.0, 1.0)
    cell_fault(p, s, INTERLOCK_OPEN, closed and is_missing(p["interlock"], s["interlock"]), 0.0, 1.0)
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
    parks = (state == RAMPING and s["soft"] == 0) or (state == ARMING and s["phase"] == PARKED)
    moves = is_enabled(s) and not parks
    cell_fault(p, s, DRIVER_ERROR, code > 0, float(code), 0.0)
    cell_fault(p, s, LINK_LOST, s["link_down"] != 0 and is_enabled(s), float(-1 - code), 0.0)
    cell_fault(p, s, OUTPUTS_TAKEN, taken and moves, float(FIRST_TAKEN - code), 0.0)


@compiled
def decay_hold(p: Record, s: Record) -> None:
    """In a hold for want of a reference the axes go back to their working points."""
    decays = s["state"] == HOLDING and s["fault"] == REFERENCE_LOST
    passed = float(s["cycle"] - s["entered_cycle"])
    for i in range(p["axes"]):
        s["axis"][i]["hold_scale"] = (
            1.0 - minimum_jerk(passed / p["axis"][i]["watch"]["decay_cycles"]) if decays else 1.0
        )


@compiled
def decouple(p: Record, s: Record, phase: int) -> None:
    """What the next set-point of each axis owes to the references of the others, as they were followed in this cycle.

    A frozen axis stays where it is, and so does what the others owe to it.
    """
    for i in range(p["axes"]):
        law, a = p["axis"][i]["decoupling"], s["axis"][i]
        own = a["decoupling"]
        if law["active"] == 0 and own["active"] == 0:
            continue
        if phase_of_axis(s, a, phase) != CLOSED or a["estimator"]["running"] == 0:
            forget(own)
            continue
        own["active"], own["added_um"] = 0, 0.0
        for j in range(p["axes"]):
            other = s["axis"][j]
            ease_share(law, own, j, EASED * p["axis"][i]["authority_step"])
            if phase_of_axis(s, other, phase) == CLOSED:
                answer(law, own, j, other["reference"]["w"])
            own["added_um"] += own["part_um"][j]


@compiled
def cell_cycle(p: Record, s: Record, signals: Any, outputs: Any, samples: Any, command: int, now_ns: int) -> bool:
    """The cycle of all axes that ``begin_cycle`` counted; False where `command` was refused."""
    for i in range(p["axes"]):
        sample(p["axis"][i], s["axis"][i], signals, now_ns, s["missed"])
    read_lines(p, s, signals, now_ns)
    watch_cell(p, s)
    accepted = command == NO_COMMAND or apply_command(p, s, command)
    finish_phase(p, s, is_on(p["retracted"], s["retracted"]))
    phase, fraction = phase_of(p, s)
    if s["state"] == ARMING:
        judge_checks(p, s, phase)
        watch_arming(p, s, phase)
        watch_lift(p, s)
        phase, fraction = phase_of(p, s)
        fraction = arming_step(p, s, phase, fraction)
    decay_hold(p, s)
    follow_part(p, s, signals, now_ns)
    follow_tool(p, s, signals, now_ns)
    s["phase"] = phase
    follows = s["state"] == TRACKING or (s["state"] == RAMPING and s["soft"] != 0)
    tracked = s["cycle"] - s["tracking_cycle"] if follows else -1
    t_s = tracked * p["period_ns"] * 1e-9
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        own = phase_of_axis(s, a, phase)
        a["move"]["held"] = 1 if s["state"] == HOLDING and s["fault"] == NO_FAULT and s["stopping"] == 0 else 0
        a["learned"]["part_begun"] = s["part_begun"] if s["part"] != 0 else -1
        a["learned"]["other_tool"] = 1 if s["tool"] != p["learned_tool"] else 0
        a["reference"]["followed"] = 1 if own == CLOSED and s["state"] != HOLDING else 0
        share = minimum_jerk(lift_fraction(p, s, a, fraction)) if own == LIFTING else fraction
        finite = axis_cycle(axis, a, s["cycle"], now_ns, t_s, samples, own, share)
        axis_fault(p, s, i, NOT_FINITE, not finite, a["setpoint_um"], math.nan)
        outputs[axis["voltage"]] = a["voltage_V"]
        if s["state"] == TRACKING and tracked >= p["score_cycles"]:
            error, uncompensated = path_error(axis, a, signals)
            score(a, error, uncompensated)
        if s["state"] == TRACKING and axis["mode"] != VOLTAGE:
            mean_squares(p, axis, a)
    decouple(p, s, phase)
    keep_checks(p, s)
    switch(p, s, outputs)
    return accepted
