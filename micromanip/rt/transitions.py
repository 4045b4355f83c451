"""The cell's states, and what its axes do in each.

    OFF -> READY -> ARMING -> TRACKING <-> HOLDING     arm (``arming.py``), hold; arm again resumes a hold
             ^        |         |            |
             +--- RAMPING <-----+------------+        disarm, stop, fault: smoothly to the park voltage
                    |
                    +--> OFF or FAULT                 FAULT is latched until reset; nothing re-arms by itself

A disarm or a stop while tracking first fades the correction out with the loops closed (``soft``); a fault ramps at
once. READY means that everything rests: the end of a ramp waits until the devices have taken their safe values. A cell
that is to stop (``stopping``) ends in OFF, whatever happens meanwhile.
"""

from __future__ import annotations

from micromanip.rt.laws.move import minimum_jerk

from . import states
from .arming import arming_cycles, arming_phase
from .axis_order import hold_here
from .jit import compiled
from .record import Record


@compiled
def enter(s: Record, state: int) -> None:
    """Change the cell's state, and note when."""
    s["state"] = state
    s["entered_cycle"] = s["cycle"]


@compiled.rare
def begin_hold(p: Record, s: Record) -> None:
    """Freeze the correction: every axis stays where it is, its loops closed."""
    for i in range(p["axes"]):
        hold_here(s, i)
    enter(s, states.HOLDING)


@compiled
def begin_soft_stop(p: Record, s: Record) -> None:
    """Fade the correction out with the loops closed; the ramp follows."""
    for i in range(p["axes"]):
        if p["axis"][i]["mode"] != states.STAGE:
            hold_here(s, i)
    s["soft"] = 1
    enter(s, states.RAMPING)


@compiled.rare
def begin_ramp(p: Record, s: Record) -> None:
    """Start the ramp of all axes to the park voltage; a ramp under way is not restarted."""
    if s["state"] == states.RAMPING and s["soft"] == 0:
        return
    for i in range(p["axes"]):
        s["order"][i]["start_V"] = s["axis"][i]["voltage_V"]
    s["soft"] = 0
    enter(s, states.RAMPING)


@compiled
def is_parked(p: Record, s: Record) -> bool:
    """Whether every output of the loop gets to its park voltage within this cycle, however slow its slew limit is."""
    for i in range(p["axes"]):
        limiter = p["axis"][i]["limiter"]
        if abs(s["axis"][i]["voltage_V"] - limiter["park_V"]) > limiter["slew_V"]:
            return False
    return True


@compiled
def finish_phase(p: Record, s: Record, retracted: bool) -> None:
    """Enter the next state at the end of arming, a hold or a ramp.

    A hold that can't be resumed ends once the tool is out of the cut, or the time is up.
    """
    passed = s["cycle"] - s["entered_cycle"]
    state = s["state"]
    waits_for_nobody = s["fault"] != states.NO_FAULT or s["stopping"] != 0
    hold_over = state == states.HOLDING and waits_for_nobody and (retracted or passed >= p["hold_cycles"])
    faded = state == states.RAMPING and s["soft"] != 0 and passed >= p["authority_cycles"]
    if state == states.ARMING and passed >= arming_cycles(p, s):
        s["tracking_cycle"] = s["cycle"]
        enter(s, states.TRACKING)
    elif hold_over or faded:
        begin_ramp(p, s)
    elif state == states.RAMPING and s["soft"] == 0 and passed >= p["ramp_cycles"] and is_parked(p, s):
        if s["fault"] != states.NO_FAULT:
            enter(s, states.FAULT)
        elif s["outputs_away"] == 0 or s["stopping"] != 0:
            enter(s, states.READY)
    if s["stopping"] != 0 and s["state"] in (states.READY, states.FAULT) and is_parked(p, s):
        enter(s, states.OFF)


@compiled
def phase_of(p: Record, s: Record) -> tuple[int, float]:
    """What the axes do in this cycle, and how far they are with it (0..1)."""
    passed = float(s["cycle"] - s["entered_cycle"])
    if s["state"] == states.ARMING:
        return arming_phase(p, s, passed)
    if s["state"] == states.TRACKING:
        return states.CLOSED, 1.0
    if s["state"] == states.HOLDING:
        return states.CLOSED, 0.0
    if s["state"] == states.RAMPING and s["soft"] != 0:
        return states.CLOSED, 1.0 - minimum_jerk(passed / p["authority_cycles"])
    if s["state"] == states.RAMPING:
        return states.PARKING, minimum_jerk(passed / p["ramp_cycles"])
    return states.PARKED, 0.0


@compiled
def phase_of_axis(s: Record, i: int, phase: int) -> int:
    """The phase of axis `i`: the cell's, except before the axis' turn in the lift, and in a hold with a frozen voltage
    because its sensors disagree.
    """
    if phase == states.LIFTING and s["arming"][i]["lifted"] == 0:
        return states.PARKED
    return states.FROZEN if s["state"] == states.HOLDING and s["watch"][i]["frozen"] != 0 else phase


@compiled
def begin_cycle(s: Record, missed: int) -> None:
    """Count the cycle that begins, and the `missed` ones before it: faults raised from here on belong to this cycle.

    Arming and ramps stood still during missed cycles, so they never jump.
    """
    s["cycle"] += 1 + missed
    s["missed"] = missed
    if s["state"] == states.ARMING or s["state"] == states.RAMPING:
        s["entered_cycle"] += missed
