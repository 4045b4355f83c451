"""Drives in the loop: what each says in a frame, and what it is sent next.

A drive is asked to operate while the loop permits it, from the moment on at which the permission came. Whatever takes
it out of Operation enabled, the link included, ends that: it is not asked again before the loop has taken its
permission back. While it is not enabled its target is where it is, so that nothing steps when it comes to be.

The power state machine is that of CiA 402 (IEC 61800-7-201): state by statusword, controlword by state.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.driver.datagrams import bits_at, find_code, value_of

from .compiled import compiled
from .drive_records import (
    FAULT,
    FAULT_REACTION,
    FAULTED,
    LATE,
    LEFT,
    LOST,
    NOT_READY,
    NOTHING,
    OPERATION,
    QUICK_STOP,
    READY,
    STAYS,
    SWITCH_ON_DISABLED,
    SWITCHED_ON,
    UNKNOWN,
)

DISABLE_VOLTAGE, STOP_QUICKLY, SHUTDOWN, SWITCH_ON, ENABLE_OPERATION, RESET_FAULT = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
"""Controlwords; the last one acts when its bit 7 becomes 1."""
_WITHOUT_QUICK_STOP, _WITH_QUICK_STOP = 0x4F, 0x6F
"""Bits of the statusword that tell states apart: bit 5 (no quick stop) means nothing in some of them."""


@compiled
def state_of(status: int) -> int:
    """The state that a statusword tells of."""
    narrow, wide = status & _WITHOUT_QUICK_STOP, status & _WITH_QUICK_STOP
    if narrow == 0x00:
        return NOT_READY
    if narrow == 0x40:
        return SWITCH_ON_DISABLED
    if narrow == 0x0F:
        return FAULT_REACTION
    if narrow == 0x08:
        return FAULT
    if wide == 0x21:
        return READY
    if wide == 0x23:
        return SWITCHED_ON
    if wide == 0x27:
        return OPERATION
    return QUICK_STOP if wide == 0x07 else UNKNOWN


@compiled
def controlword(state: int, asked: Any, may_operate: Any, resets: Any, stop: int) -> int:
    """What a drive in `state` is sent next: one step towards Operation enabled where it is `asked` for, else `stop`.

    A fault is left only where somebody `resets` it; a quick stop is never taken back.
    """
    if state == FAULT and resets:
        return RESET_FAULT
    if not asked:
        return stop if state in (OPERATION, QUICK_STOP) else DISABLE_VOLTAGE
    if state == SWITCH_ON_DISABLED:
        return SHUTDOWN
    if state == READY or (state == SWITCHED_ON and not may_operate):
        return SWITCH_ON
    if state in (SWITCHED_ON, OPERATION):
        return ENABLE_OPERATION
    return DISABLE_VOLTAGE


_FOLLOWS, _FOLLOWING_ERROR = 1 << 12, 1 << 13
"""Bits of the statusword in the cyclic modes: the drive takes its target; it does not keep up with it (csp)."""


@compiled
def hear_drives(c: Any, data: Any, inputs: Any, at_ns: int) -> None:
    """A complete frame, of `at_ns`: judge each drive by it, and leave its ``ok`` as a sample."""
    f = c["receive"]
    for k in range(c["drives"]):
        d = c["drive"][k]
        d["status"] = np.int64(bits_at(data, d["status_at"], 2, 0))
        d["error"] = np.int64(bits_at(data, d["error_at"], 2, 0))
        shown: Any = np.int64(bits_at(data, d["shown_at"], 1, 0))
        d["shown_mode"] = shown - 256 if shown > 127 else shown
        if d["actual_number"] >= 0:
            d["actual"] = value_of(f, f["number"][d["actual_number"]], data)
        d["state"] = state_of(d["status"])
        judge_drive(d)
        signal = inputs[d["ok"]]
        signal["value"], signal["time_ns"], signal["status"] = 1.0 if is_ok(d) else 0.0, at_ns, 0
        signal["sequence"] += 1


@compiled
def judge_drive(d: Any) -> None:
    """Whether it has come to operate, or does no longer."""
    if d["asked"] == 0:
        return
    if operates(d):
        d["enabled"] = 1
    elif d["enabled"] != 0:
        d["losses"] += 1
        revoke(d, LEFT)
    elif d["state"] == FAULT or d["state"] == FAULT_REACTION:
        revoke(d, FAULTED)


@compiled
def operates(d: Any) -> bool:
    """Whether it puts its target into force."""
    lags = d["tells_following_error"] != 0 and d["status"] & _FOLLOWING_ERROR != 0
    return d["state"] == OPERATION and d["shown_mode"] == d["mode"] and d["status"] & _FOLLOWS != 0 and not lags


@compiled
def revoke(d: Any, why: int) -> None:
    """It is not asked to operate any more, whatever the loop permits, before that has been taken back."""
    d["revoked"], d["asked"], d["enabled"], d["taken_up"], d["why"] = 1, 0, 0, 0, why
    end = d["end"]
    end["why"], end["state"], end["status"], end["shown_mode"] = why, d["state"], d["status"], d["shown_mode"]
    end["error"], end["actual"], end["fits"] = d["error"], d["actual"], d["fits"]
    end["number"] += 1


@compiled
def is_ok(d: Any) -> bool:
    """Whether it is as it is asked to be."""
    if d["why"] != NOTHING or d["state"] in (FAULT, FAULT_REACTION, NOT_READY, UNKNOWN):
        return False
    return bool(d["asked"] == 0 or (d["enabled"] != 0 and d["taken_up"] != 0))


@compiled
def command_drives(c: Any, code: int, outputs: Any, deadline_ns: int) -> None:
    """What all outputs are sent in a cycle whose ``turn`` returned `code` into ``asked``, words into the frame.

    As without drives, but for their targets while they are not enabled, or not yet where the loop asks them to be.
    """
    g = c["gate"]
    for i in range(g["outputs"][0]):
        c["asked"][i] = outputs[i] if code == 0 else g["safe"][i]
    for k in range(c["drives"]):
        d = c["drive"][k]
        ask_drive(d, code, outputs[d["enable"]] == 1.0, deadline_ns)
        see_reset(d, code == 0 and d["reset"] >= 0 and outputs[max(0, d["reset"])] == 1.0)
        aim(c, d)
        word = controlword(
            d["state"],
            d["asked"] != 0,
            d["fits"] != 0 and d["shown_mode"] == d["mode"],
            d["resets"] != 0,
            word_to_stop(d, deadline_ns),
        )
        template, at = c["send"]["template"], d["control_at"]
        template[at], template[at + 1] = np.uint8(word & 0xFF), np.uint8(word >> 8)


@compiled
def ask_drive(d: Any, code: int, permitted: Any, deadline_ns: int) -> None:
    """Whether it is asked to operate: `permitted` by the loop, whose outputs it gets (`code` 0), and not revoked."""
    if not permitted:
        d["revoked"] = d["asked"] = d["enabled"] = d["taken_up"] = 0
        if d["why"] != STAYS:
            d["why"] = NOTHING
        return
    if code != 0 and d["revoked"] == 0:
        revoke(d, LOST)
    if d["revoked"] != 0:
        return
    if d["asked"] == 0:
        d["asked"], d["enabled"], d["taken_up"], d["began_ns"], d["why"] = 1, 0, 0, deadline_ns, NOTHING
    late = deadline_ns - d["began_ns"] > d["enable_ns"]
    if late and (d["enabled"] == 0 or d["taken_up"] == 0):
        revoke(d, LATE)


@compiled
def see_reset(d: Any, is_on: Any) -> None:
    """A fault is reset while the operator's switch is on, from the moment on at which it came on in that fault."""
    if is_on and d["reset_was_on"] == 0 and d["state"] == FAULT:
        d["resets"] = 1
    if not is_on or d["state"] != FAULT:
        d["resets"] = 0
    d["reset_was_on"] = 1 if is_on else 0


@compiled
def word_to_stop(d: Any, deadline_ns: int) -> int:
    """What it is sent where it operates, or stops, and is not asked to operate: after `stop_ns` the voltage goes."""
    runs_on = d["asked"] == 0 and (d["state"] == OPERATION or d["state"] == QUICK_STOP)
    if not runs_on:
        d["stopping"] = 0
        if d["why"] == STAYS:
            d["why"] = NOTHING
        return DISABLE_VOLTAGE
    if d["stopping"] == 0:
        d["stopping"], d["stopped_ns"] = 1, deadline_ns
    if deadline_ns - d["stopped_ns"] <= d["stop_ns"]:
        return d["stop_word"]  # type: ignore[no-any-return]
    d["why"] = STAYS
    return DISABLE_VOLTAGE


@compiled
def aim(c: Any, d: Any) -> None:
    """Its target: where it is, before it is enabled; from there to what the loop asks for; then just that."""
    g, i = c["gate"], d["target"]
    if d["enabled"] == 0:
        held = where_it_is(c, d)
        c["asked"][i] = g["lowest"][i] = g["highest"][i] = held
        return
    if d["taken_up"] != 0:
        return
    given, wanted = g["last"][i], c["asked"][i]
    away = wanted - given
    if abs(away) <= d["take_up"]:
        d["taken_up"] = 1
    elif math.isfinite(away):
        c["asked"][i] = given + math.copysign(d["take_up"], away)


@compiled
def where_it_is(c: Any, d: Any) -> float:
    """The target that moves nothing: its position, where it has one, else the value at rest.

    A position that can't be sent as a target forbids that it be enabled; the nearest that can is sent meanwhile.
    """
    g, f, i = c["gate"], c["send"], d["target"]
    rest: float = g["safe"][i]
    if d["actual_number"] < 0:
        d["fits"] = 1
        return rest
    n, actual = f["number"][i], d["actual"]
    within = n["low"] <= actual <= n["high"] and find_code(n, actual, n["bits"], f["bits"])
    d["fits"] = 1 if within else 0
    if within:
        return actual  # type: ignore[no-any-return]
    return min(max(actual, n["low"]), n["high"]) if math.isfinite(actual) else rest
