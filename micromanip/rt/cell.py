"""One cycle of the whole cell: sensors, what is watched, commands, states, axes, outputs.

The states and their changes are in ``transitions.py``, the sequence of arming in ``arming.py``, what is watched in
``watch.py`` and ``faults.py``. The same function runs in the 10 kHz loop and, in virtual time, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.coordinate_transform import owed_um
from micromanip.rt.laws.move import minimum_jerk

from . import states
from .arming import lift_fraction
from .axis import axis_cycle, measure
from .checks import advance_arming, keep_checks
from .commands import apply_command
from .digital_io import follow_part, follow_tool, is_enabled, is_missing, is_on, read_line, switch
from .errors import mean_squares, path_error, score
from .faults import axis_fault, cell_fault
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
def held_share(p: Record, s: Record, i: int) -> float:
    """Share (0..1) of the held position of axis `i`; it falls to 0 in a hold after a lost reference."""
    if s["state"] == states.RAMPING and p["axis"][i]["mode"] == states.STAGE:
        return 0.0
    if s["state"] != states.HOLDING or s["fault"] != states.REFERENCE_LOST:
        return 1.0
    passed = float(s["cycle"] - s["entered_cycle"])
    return 1.0 - minimum_jerk(passed / p["axis"][i]["watch"]["decay_cycles"])


@compiled
def give_orders(p: Record, s: Record, phase: int, fraction: float) -> None:
    """Write each axis' order for this cycle, from the cell's state, the watch and the machine."""
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
    """Add the cross-coupling feedforward from the other axes' references of the cycle before."""
    for i in range(p["axes"]):
        law, a = p["axis"][i]["decoupling"], s["axis"][i]
        a["added_um"] = 0.0
        if law["active"] != 0 and s["order"][i]["phase"] == CLOSED and a["estimator"]["running"] != 0:
            for j in range(p["axes"]):
                a["added_um"] += owed_um(law, j, s["axis"][j]["reference"]["w"])


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
    decouple(p, s)
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
            mean_squares(p["figures_step"], axis, a, s["figures"][i])
    keep_checks(p, s)
    switch(p, s, outputs)
    return accepted
