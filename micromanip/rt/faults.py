"""Fault manager: records, latches and answers a condition in the cycle in which it is detected.

A condition that becomes true is an event (``note``); a fault brings its configured reaction: WARN only reports, HOLDS
freezes the correction (a ramp follows), RAMPS goes smoothly to park, CUTS follows an amplifier that is off. The first
fault that is more than a warning stays latched until ``reset``; a later one can only make the reaction stronger. The
exception is the fault that ends the run: it is a trip of its own, and the fault before is kept in ``former``. One
faulty axis stops the cell: a spindle corrected in two axes cuts a wrong path.

What is watched on each axis is in ``watch.py``, the states that the reactions lead to in ``transitions.py``.
"""

from __future__ import annotations

from .jit import compiled
from .record import Record, record
from .states import ARMING, CLOSED, CUTS, FAULT, HOLDING, HOLDS, HOST_DEAD, NO_FAULT, OFF, READY, TRACKING, WARN
from .transitions import begin_hold, begin_ramp, enter

EVENTS = 32
"""Events that the loop remembers."""
EVENT = record(
    ("cycle", "i8"),
    ("code", "i8"),
    ("axis", "i8"),
    ("value", "f8"),
    ("limit", "f8"),
    ("reaction", "i8"),
    ("state", "i8"),
)
"""A fault or a warning as it was raised: when, what, on which axis (-1: the cell), measured and limit."""


@compiled
def note(s: Record, code: int, axis: int, value: float, limit: float, reaction: int) -> None:
    """Record an event; the ring keeps the newest."""
    event = s["event"][s["events"] % EVENTS]
    event["cycle"], event["code"], event["axis"] = s["cycle"], code, axis
    event["value"], event["limit"], event["reaction"], event["state"] = value, limit, reaction, s["state"]
    s["events"] += 1


@compiled
def begins(w: Record, code: int, active: bool) -> bool:
    """True in the cycle in which the condition `code` becomes active; ``w["raised"]`` keeps a bit for each.

    Most cycles change nothing: then nothing is written.
    """
    bit = 1 << code
    if active == (w["raised"] & bit != 0):
        return False
    w["raised"] ^= bit
    return active


@compiled
def axis_fault(p: Record, s: Record, axis: int, code: int, active: bool, value: float, limit: float) -> None:
    """Raise a fault or a warning of an axis where its condition begins; again once that has been away."""
    if begins(s["watch"][axis], code, active):
        raise_fault(p, s, code, axis, value, limit, p["axis"][axis]["watch"]["reaction"][code])


@compiled
def cell_fault(p: Record, s: Record, code: int, active: bool, value: float, limit: float) -> None:
    """Raise a fault of the whole cell where its condition begins."""
    if begins(s, code, active):
        raise_fault(p, s, code, -1, value, limit, p["reaction"][code])


@compiled.rare
def raise_fault(p: Record, s: Record, code: int, axis: int, value: float, limit: float, reaction: int) -> None:
    """Record a fault, latch it (the first one stays) and react; a warning is only recorded."""
    note(s, code, axis, value, limit, reaction)
    if reaction == WARN:
        return
    ends_run = code == HOST_DEAD and s["fault"] != NO_FAULT
    if ends_run:
        s["former"], s["former_axis"] = s["fault"], s["fault_axis"]
        s["former_value"], s["former_limit"] = s["fault_value"], s["fault_limit"]
    if ends_run or s["fault"] == NO_FAULT:
        s["fault"], s["fault_axis"], s["fault_cycle"] = code, axis, s["cycle"]
        s["fault_value"], s["fault_limit"] = value, limit
        s["trips"] += 1
    react(p, s, reaction)


@compiled
def react(p: Record, s: Record, reaction: int) -> None:
    """Enter the state that `reaction` requires; a milder reaction never replaces a stronger one."""
    state = s["state"]
    if reaction == CUTS:
        if state != OFF:
            enter(s, FAULT)  # an amplifier that is off is followed: no ramp
    elif state in (READY, OFF):
        enter(s, FAULT)
    elif reaction == HOLDS and state == HOLDING:
        if s["fault_cycle"] == s["cycle"]:
            enter(s, HOLDING)  # one that was asked for: from now on its time is limited
    elif reaction == HOLDS and (state == TRACKING or (state == ARMING and s["phase"] == CLOSED)):
        begin_hold(p, s)
    elif state != FAULT:
        begin_ramp(p, s)


@compiled.rare
def forget(p: Record, s: Record) -> None:
    """Unlatch, with an empty bucket; every condition that persists is raised again in the next cycle."""
    s["fault"] = NO_FAULT
    s["raised"] = 0
    s["overruns_in_a_row"] = 0
    s["overrun_level"] = 0.0
    for i in range(p["axes"]):
        s["watch"][i]["raised"] = s["watch"][i]["frozen"] = 0
