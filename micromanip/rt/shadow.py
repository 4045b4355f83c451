"""Tunings: one replaces another; a candidate computes beside it, is promoted, and taken back if worse.

The candidate gets the same samples and the set-points that were really given, so that its innovation shows how well its
model fits the plant; its integrator follows the voltage that was really written, so that it never winds up. Once
promoted it is on trial: where the mean square error grows beyond what it was before, by a factor, or the inner loop
begins to oscillate, or a fault occurs, the previous tuning is in force again in the same cycle.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.laws.estimator import remember
from micromanip.rt.laws.pid import unwind

from . import states
from .arming import carry_checks
from .axis import axis_cycle, change_axis
from .errors import following_error, mean_squares
from .faults import note
from .jit import compiled
from .record import Record

_WITHDRAWN = -1
_PATIENCE = 3
"""Longest duration of a trial as a multiple of its length; a tuning that can't be judged by then is taken back."""


@compiled.rare
def swap_cell(old: Record, new: Record, s: Record) -> None:
    """Carry the states of the whole cell over; the caller uses `new` from this cycle on."""
    for i in range(new["axes"]):
        change_axis(old["axis"][i], new["axis"][i], s["axis"][i])
        carry_checks(old["axis"][i], new["axis"][i], s["arming"][i])
        s["watch"][i]["fallback"] = s["watch"][i]["band_cycles"] = 0
    s["version"] = new["version"]


@compiled.rare
def start_shadow(p: Record, candidate: Record, s: Record, shadow: Record) -> None:
    """Begin with `candidate` where the active tuning is."""
    for i in range(candidate["axes"]):
        shadow["axis"][i], shadow["figures"][i] = s["axis"][i], s["figures"][i]
    swap_cell(p, candidate, shadow)
    s["shadow"] = states.SHADOWING


@compiled.rare
def promote(p: Record, s: Record) -> bool:
    """Begin the trial; False without a candidate, or if the cell does not track."""
    if s["shadow"] != states.SHADOWING or s["state"] != states.TRACKING:
        return False
    s["shadow"] = states.ON_TRIAL
    s["trial_cycles"] = s["trial_judged"] = s["trial_rest"] = 0
    s["trial_overruns"] = s["overruns"]
    for i in range(p["axes"]):
        s["trial_before"][i] = s["trial_now"][i] = s["figures"][i]["error"]
    return True


@compiled
def withdraw(s: Record) -> bool:
    """Drop the candidate, or end its trial; False if there is neither."""
    if s["shadow"] == states.ON_TRIAL:
        s["trial_cycles"] = _WITHDRAWN
        return True
    there = s["shadow"] == states.SHADOWING
    if there:
        s["shadow"] = states.NO_SHADOW
    return there


@compiled
def takes_back(p: Record, s: Record) -> bool:
    """One cycle of the trial of the promoted tuning `p`; True if the previous tuning must be restored."""
    if s["shadow"] != states.ON_TRIAL:
        return False
    worse = s["state"] != states.TRACKING or s["fault"] != states.NO_FAULT or s["trial_cycles"] == _WITHDRAWN
    axis, share, value, limit = -1, -1.0, 0.0, 0.0  # which one is to blame, and the largest error
    # after a missed deadline the trial rests: what the stall does to the error is not the tuning's fault
    if s["overruns"] != s["trial_overruns"]:
        s["trial_overruns"], s["trial_rest"] = s["overruns"], p["trial_rest"]
    s["trial_rest"] = max(0, s["trial_rest"] - 1)
    judged = s["trial_rest"] == 0
    for i in range(p["axes"]):
        a = s["axis"][i]
        if p["axis"][i]["mode"] == states.VOLTAGE:
            continue
        if judged:
            error_um = following_error(p["axis"][i], a)
            s["trial_now"][i] += p["trial_step"] * (error_um * error_um - s["trial_now"][i])
        rms_um = math.sqrt(s["trial_now"][i])
        allowed_um = p["trial_factor"] * math.sqrt(s["trial_before"][i]) + p["trial_floor"]
        if not worse and (rms_um > allowed_um or s["watch"][i]["fallback"] != 0):
            worse, axis, value, limit = True, i, rms_um, allowed_um
        elif axis < 0 and rms_um > share * allowed_um:
            share, value, limit = rms_um / allowed_um, rms_um, allowed_um
    s["trial_cycles"] += 1
    if judged:
        s["trial_judged"] += 1
    over = s["trial_cycles"] >= p["trial_cycles"] and 4 * s["trial_judged"] >= p["trial_cycles"]
    worse = worse or (not over and s["trial_cycles"] >= _PATIENCE * p["trial_cycles"])  # it can't be judged here
    if worse:
        s["shadow"] = states.TAKEN_BACK
        note(s, states.ROLLED_BACK, axis, value, limit, states.WARN)
    elif over:
        s["shadow"] = states.CONFIRMED
    return worse


@compiled
def shadow_cycle(p: Record, candidate: Record, s: Record, shadow: Record, samples: Any, now_ns: int) -> None:
    """One cycle of the candidate beside the active tuning, while that tracks; nothing of it is written."""
    if s["shadow"] != states.SHADOWING or s["state"] != states.TRACKING:
        return
    if s["cycle"] == s["tracking_cycle"]:  # a candidate from before: it begins anew, where the active tuning is
        start_shadow(p, candidate, s, shadow)
    for i in range(candidate["axes"]):
        axis, a, b = candidate["axis"][i], s["axis"][i], shadow["axis"][i]
        if axis["mode"] == states.VOLTAGE:
            continue
        b["strain"], b["stage"], b["reference"] = a["strain"], a["stage"], a["reference"]
        b["added_um"], b["voltage_V"] = a["added_um"], a["voltage_V"]
        axis_cycle(axis, b, s["order"][i], s["cycle"], now_ns, samples)
        unwind(axis["pid"], b["pid"], b["voltage_V"] - a["voltage_V"])
        remember(b["estimator"], a["setpoint_um"] - axis["centre_um"] - a["added_um"])
        b["voltage_V"] = a["voltage_V"]
        mean_squares(candidate["figures_step"], axis, b, shadow["figures"][i])
