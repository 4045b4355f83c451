"""Arming's own monitoring and offsets: the steps of the polarity checks, their verdict, the sweep.

The result of a check counts until something happens that could change the response: ``keep_checks``.
"""

from __future__ import annotations

import math

from micromanip.rt.laws.reference import SIGNAL
from micromanip.rt.laws.sensor import BELIEVED, is_silent

from . import states
from .arming import (
    OF_GAUGE,
    OF_STAGE,
    answer,
    check_step,
    forget_checks,
    gather,
    judge,
    lift_fraction,
    lift_target,
    stage_loss,
    sweep_offset,
)
from .axis import start_axis
from .faults import axis_fault, raise_fault
from .jit import compiled
from .record import Record
from .states import CHECKING_GAUGE, CHECKING_STAGE, CLOSED, LIFTING, SWEEPING
from .transitions import phase_of
from .watch import lasting

_UNUSABLE_CYCLES = 20
"""A capacitive sensor unusable for longer is not waited for, however patient the watch may be while tracking."""
_CELL_CHANGED = 1 << states.DRIVER_ERROR | 1 << states.LINK_LOST
_APART = 1 << states.DISAGREEMENT | 1 << states.STAGE_DRIFT
_GAUGE_LOST = 1 << states.STRAIN_INVALID | 1 << states.STRAIN_SILENT | 1 << states.STRAIN_STUCK
_GAUGE_CHANGED = _APART | _GAUGE_LOST | 1 << states.AMPLIFIER_FAULT | 1 << states.STRAIN_CHECK
_STAGE_CHANGED = 1 << states.STAGE_INVALID | 1 << states.STAGE_STUCK | 1 << states.STAGE_CHECK
"""Faults after which a device, a cable or a setting may have been changed or repaired."""


@compiled.rare
def advance_arming(p: Record, s: Record) -> tuple[int, float]:
    """Go on with arming, watched; what the axes do in this cycle, and how far they are with it (0..1)."""
    phase, _ = phase_of(p, s)
    judge_checks(p, s, phase)
    watch_arming(p, s, phase)
    watch_lift(p, s)
    phase, fraction = phase_of(p, s)  # of another state where one of them has ended arming
    return phase, arming_step(p, s, phase, fraction)


@compiled
def arming_step(p: Record, s: Record, phase: int, fraction: float) -> float:
    """Offsets of the axes in a check or a sweep, and what a check gathers; the fraction that the axes get.

    In a check the axes have their turn one after the other, `fraction` is the place in all of them together.
    """
    checking, kind = phase in (CHECKING_GAUGE, CHECKING_STAGE), int(phase == CHECKING_STAGE)
    place = fraction * s["checks"][kind] if checking else 0.0
    turn = int(place)
    for i in range(p["axes"]):
        axis, a, own, order = p["axis"][i], s["axis"][i], s["arming"][i], s["order"][i]
        if phase == LIFTING and own["lifted"] == 0 and lift_fraction(p, s, i, fraction) >= 0.0:
            order["start_V"] = a["voltage_V"]
            start_axis(axis, a)
            own["check"][OF_GAUGE]["shown_V"], own["check"][OF_GAUGE]["outside"] = a["voltage_V"], 0
            own["lifted"] = 1
        order["offset"] = 0.0
        if phase == SWEEPING and axis["mode"] != states.VOLTAGE:
            order["offset"] = sweep_offset(p, axis, lift_target(axis, a), fraction)
        if checking and own["check"][kind]["turn"] == turn + 1:
            order["offset"] = axis["check"][kind]["step"] * check_step(place - turn)
            value = a["stage"]["value"] if kind == OF_STAGE else a["strain"]["value"]
            gather(own["check"][kind], place - turn, value)
    if phase == CHECKING_GAUGE:
        return 0.0
    return 1.0 if checking or phase == SWEEPING else fraction


@compiled
def judge_checks(p: Record, s: Record, phase: int) -> None:
    """Where the polarity and scale checks of a kind have ended: every answer inside what is expected, or a fault."""
    was = s["phase"]
    if phase == was or was not in (CHECKING_GAUGE, CHECKING_STAGE):
        return
    kind = int(was == CHECKING_STAGE)
    code = states.STAGE_CHECK if kind == OF_STAGE else states.STRAIN_CHECK
    for i in range(p["axes"]):
        limits, c = p["axis"][i]["check"][kind], s["arming"][i]["check"][kind]
        if c["turn"] > 0:
            found = answer(c, limits["step"])
            good = judge(c, limits, found)
            axis_fault(p, s, i, code, not good, found, limits["high"] if found > limits["high"] else limits["low"])


@compiled
def watch_arming(p: Record, s: Record, phase: int) -> None:
    """Abort arming if a sensor is missing, before an outer loop is closed or a reference followed.

    Until then each capacitive sensor must be there, if need be at an end of its range; it may be away for as long as a
    gauge. In the cycle that closes the loop it must not be at an end, and the estimator must have started from its
    samples. From then on ``watch.py`` looks after it.
    """
    closing = phase == CLOSED and s["phase"] != CLOSED
    if s["state"] != states.ARMING or s["resumed"] != 0 or (phase == CLOSED and not closing):
        return
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        limits, silent = axis["watch"], a["reference"]["silent"]
        samples = min(limits["stage_samples"], _UNUSABLE_CYCLES) + limits["coast_cycles"]
        code = stage_loss(axis, a, samples, closing) if axis["mode"] == states.STAGE else states.NO_FAULT
        if code == states.STAGE_STUCK:
            end_arming(p, s, i, code, float(a["stage"]["identical"]), float(limits["stage_identical"]))
        elif code != states.NO_FAULT or (closing and axis["mode"] == states.STAGE and a["estimator"]["running"] == 0):
            silent_cycles = int(a["stage"]["silent_ns"] * axis["cycles_per_ns"])
            end_arming(p, s, i, states.STAGE_INVALID, float(max(a["stage"]["bad"], silent_cycles)), float(samples))
        if closing and axis["reference"]["kind"] == SIGNAL and silent >= limits["lost_cycles"]:
            end_arming(p, s, i, states.REFERENCE_LOST, float(silent), float(limits["lost_cycles"]))


@compiled
def watch_lift(p: Record, s: Record) -> None:
    """End an arming whose gauge does not follow the voltage, from the lift until the sweep.

    A gauge may have come loose, or been connected to another axis, at rest. Each axis begins alone, so no other gauge
    can appear to be its own. Since the lift began the gauge must have moved by the voltage's change times the limits of
    the check, within a small tolerance.
    """
    if s["resumed"] != 0 or p["check_cycles"] == 0 or s["phase"] not in (LIFTING, CHECKING_STAGE):
        return
    for i in range(p["axes"]):
        limits, a = p["axis"][i]["check"][OF_GAUGE], s["axis"][i]
        c, start_V = s["arming"][i]["check"][OF_GAUGE], s["order"][i]["start_V"]
        gone_V = a["voltage_V"] - start_V
        if s["arming"][i]["lifted"] == 0 or p["axis"][i]["mode"] == states.VOLTAGE:
            continue
        c["shown_V"] += limits["lag_step"] * (a["voltage_V"] - c["shown_V"])
        shown_V, gone_um = c["shown_V"] - start_V, a["strain"]["value"] - a["blend"]["held_um"]
        by_low, by_high = limits["low"], limits["high"]
        least_um = min(min(by_low * gone_V, by_high * gone_V), min(by_low * shown_V, by_high * shown_V))
        most_um = max(max(by_low * gone_V, by_high * gone_V), max(by_low * shown_V, by_high * shown_V))
        too_low, too_high = gone_um < least_um - limits["slack"], gone_um > most_um + limits["slack"]
        c["outside"] = lasting(c["outside"], too_low or too_high)
        if c["outside"] >= limits["slack_cycles"]:
            found = gone_um / math.copysign(max(abs(gone_V), abs(limits["step"])), gone_V)
            end_arming(p, s, i, states.STRAIN_CHECK, found, by_high if too_high == (gone_V > 0.0) else by_low)


@compiled.rare
def end_arming(p: Record, s: Record, axis: int, code: int, value: float, limit: float) -> None:
    """Raise a fault that ends arming whatever its reaction is while tracking: the ramp at least."""
    s["watch"][axis]["raised"] |= 1 << code
    raise_fault(p, s, code, axis, value, limit, max(states.RAMPS, p["axis"][axis]["watch"]["reaction"][code]))


@compiled
def keep_checks(p: Record, s: Record) -> None:
    """Invalidate the checks after anything that could have changed their response: the next arming repeats them.

    A link that was down, a driver or an amplifier that failed, a sensor that was silent, unusable or implausible:
    somebody may have plugged, repaired or replaced something.
    """
    changed = s["link_down"] != 0 or s["raised"] & _CELL_CHANGED != 0
    away_ns = BELIEVED * p["period_ns"]
    for i in range(p["axes"]):
        a = s["axis"][i]
        raised, strain = s["watch"][i]["raised"], a["strain"]
        if changed or raised & _GAUGE_CHANGED != 0 or strain["bad"] >= BELIEVED or is_silent(strain, away_ns):
            forget_checks(s["arming"][i], OF_GAUGE)
        elif raised & _STAGE_CHANGED != 0 or is_silent(a["stage"], away_ns):
            forget_checks(s["arming"][i], OF_STAGE)
