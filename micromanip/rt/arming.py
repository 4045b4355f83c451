"""Arming: amplifier on, polarity and scale check, lift, decaying sweep, settling, authority 0 to 100 %.

The check makes a small step on one axis after the other and compares the answer with what the configuration
expects: of the gauge to a voltage before the inner loop is closed for the first time, of the stage to a set-point
before the outer loop is. The sweep wipes the hysteresis memory of actuator and model alike: a play
whose input swings by more than its threshold forgets what was before. Refused arming says why, bit by bit.
"""

from __future__ import annotations

import math

from .course import smooth
from .jit import compiled
from .phases import BUMPING, CLOSED, LIFTING, PARKED, PROBING, SWEEPING
from .records import Record
from .reference import SIGNAL
from .sensor import is_missing
from .states import (
    AMPLIFIER_MISSING,
    ENABLE_MISSING,
    HOLDING,
    INTERLOCK_MISSING,
    LATCHED,
    LINK_MISSING,
    NO_FAULT,
    NOT_READY,
    NOT_RESUMABLE,
    OUTPUTS_MISSING,
    READY,
    REFERENCE_MISSING,
    STRAIN_MISSING,
    TEMPERATURE_MISSING,
    VOLTAGE,
)


@compiled
def refuse(p: Record, s: Record) -> bool:
    """Note in ``refused`` of the cell and of each axis why it can't be armed now; True where there is a reason."""
    resuming = s["state"] == HOLDING
    reasons = 0
    if s["state"] != READY and not resuming:
        reasons |= NOT_READY
    if s["fault"] != NO_FAULT or s["stopping"] != 0:
        reasons |= LATCHED
    if is_missing(p["enable"], s["enable"]):
        reasons |= ENABLE_MISSING
    if is_missing(p["interlock"], s["interlock"]):
        reasons |= INTERLOCK_MISSING
    if s["link_down"] != 0:
        reasons |= LINK_MISSING
    if s["outputs_taken"] != 0:
        reasons |= OUTPUTS_MISSING
    s["refused"] = reasons
    for i in range(p["axes"]):
        axis, a = p["axis"][i], s["axis"][i]
        a["refused"] = 0
        if axis["mode"] != VOLTAGE and (
            a["strain"]["bad"] > 0 or a["strain"]["identical"] >= axis["watch"]["strain_identical"]
        ):
            a["refused"] |= STRAIN_MISSING
        if axis["reference"]["kind"] == SIGNAL and (
            a["reference"]["time_ns"] == 0 or a["reference"]["silent"] >= axis["watch"]["stale_cycles"]
        ):
            a["refused"] |= REFERENCE_MISSING
        if is_missing(axis["amplifier_ok"], a["amplifier_ok"]):
            a["refused"] |= AMPLIFIER_MISSING
        if is_missing(axis["temperature_ok"], a["temperature_ok"]):
            a["refused"] |= TEMPERATURE_MISSING
        if resuming and a["frozen"] != 0:
            a["refused"] |= NOT_RESUMABLE
        reasons |= a["refused"]
    return reasons != 0


@compiled
def check_cycles(p: Record, s: Record) -> int:
    """Length of one polarity check over all axes; 0 once it has been passed since the start."""
    return 0 if s["checked"] != 0 else p["check_cycles"] * p["axes"]


@compiled
def arming_cycles(p: Record, s: Record) -> int:
    """Length of the whole sequence; what resumes a hold needs only its authority back."""
    if s["resumed"] != 0:
        return p["authority_cycles"]
    return (
        p["enable_cycles"]
        + 2 * check_cycles(p, s)
        + p["lift_cycles"]
        + p["sweep_cycles"]
        + p["settle_cycles"]
        + p["authority_cycles"]
    )


@compiled
def arming_phase(p: Record, s: Record, passed: float) -> tuple[int, float]:
    """What the axes do so many cycles after arming began, and how far they are with it (0..1)."""
    if s["resumed"] == 0:
        checking = check_cycles(p, s)
        passed -= p["enable_cycles"]
        if passed < 0.0:
            return PARKED, 0.0
        if passed < checking:
            return PROBING, passed / checking
        passed -= checking
        if passed < p["lift_cycles"]:
            return LIFTING, smooth(passed / p["lift_cycles"])
        passed -= p["lift_cycles"]
        if passed < checking:
            return BUMPING, passed / checking
        passed -= checking
        if passed < p["sweep_cycles"]:
            return SWEEPING, passed / p["sweep_cycles"]
        passed -= p["sweep_cycles"]
        if passed < p["settle_cycles"]:
            return LIFTING, 1.0
        passed -= p["settle_cycles"]
    return CLOSED, smooth(passed / p["authority_cycles"])


@compiled
def check_step(place: float) -> float:
    """Course of one axis' step (0..1) for `place` 0..1: rest, up, rest, down, a quarter each."""
    return smooth(4.0 * place - 1.0) - smooth(4.0 * place - 3.0)


@compiled
def gather(c: Record, place: float, value: float) -> None:
    """Average the sensor's value where it is at rest before the step, and at rest on it."""
    if 0.125 <= place < 0.25:
        c["before"] += value
        c["before_samples"] += 1
    elif 0.625 <= place < 0.75:
        c["after"] += value
        c["after_samples"] += 1


@compiled
def answer(c: Record, step: float) -> float:
    """What the sensor answered to the step, per unit of it; NaN before both averages are there."""
    if c["before_samples"] == 0 or c["after_samples"] == 0:
        return math.nan
    return (c["after"] / c["after_samples"] - c["before"] / c["before_samples"]) / step


@compiled
def sweep_offset(p: Record, axis: Record, target_um: float, fraction: float) -> float:
    """Decaying sweep around `target_um` at `fraction` of its time: faded in over half a turn, inside the range."""
    room = min(target_um - axis["setpoint_low_um"], axis["setpoint_high_um"] - target_um)
    amplitude = max(0.0, min(axis["sweep_um"], room))
    turns = p["sweep_turns"] * fraction
    return amplitude * smooth(2.0 * turns) * (1.0 - fraction) * math.sin(2.0 * math.pi * turns)


@compiled
def start_check(c: Record) -> None:
    """Forget what an earlier check gathered."""
    c["before"] = c["after"] = 0.0
    c["before_samples"] = c["after_samples"] = 0
