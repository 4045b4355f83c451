"""What the axes do on top of their course while arming: the steps of the polarity checks, and the sweep."""

from __future__ import annotations

from .arming import answer, check_step, gather, sweep_offset
from .axis import start_axis
from .faults import axis_fault
from .jit import compiled
from .phases import BUMPING, LIFTING, PARKED, PROBING, SWEEPING
from .records import Record
from .reference import SIGNAL
from .states import ARMED, STAGE, STAGE_CHECK, STRAIN_CHECK, VOLTAGE


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
