"""A drive with the profile CiA 402 behind a slave: its power stage, in counts of its target.

Written from the profile's own transitions 0 to 16, and without anything of the master's: a state is the pattern of its
statusword. Off, what it puts out goes to rest in 0.2 s; in a quick stop and in a fault reaction it stays for 20 ms.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import types

from micromanip.bus.ethercat.al_states import OP, STATUS_MASK
from micromanip.bus.ethercat.registers import AL_STATUS
from micromanip.rt.io.frames import bits_at, put_bits
from micromanip.rt.record import record
from micromanip.rt.signatures import array_of

from ..compiled import compiled
from .controller import ESC
from .terminal import INPUTS, OUTPUTS, Terminal

NOT_READY, SWITCH_ON_DISABLED, READY, SWITCHED_ON = 0x00, 0x40, 0x21, 0x23
ENABLED, QUICK_STOP, REACTION, FAULT = 0x27, 0x07, 0x0F, 0x08
_VOLTAGE, _REMOTE, _TAKES_TARGET, _LAGS = 1 << 4, 1 << 9, 1 << 12, 1 << 13
_RESET = 0x80
_SELF_TEST_NS, _STOPPING_NS, _FALLING_NS, _PATIENCE_NS = 10_000_000, 20_000_000, 200_000_000, 10_000_000
_POSITION = 8
_HOMING = 6
_COMMUNICATION = 0x7500
_TARGETS = (0x607A, 0x60FF, 0x6071)
_CODES = {"connection_lost": (0x6007, 1), "quick_stop": (0x605A, 2), "fault_reaction": (0x605E, 2)}
"""Option codes that it goes by, and what they are from the start."""
OBJECTS: Mapping[tuple[int, int], bytes] = {
    (0x6502, 0): struct.pack("<I", 0x380),
    **{(index, 0): struct.pack("<h", code) for index, code in _CODES.values()},
    **{(index, 0): struct.pack("<h", 1) for index in (0x605B, 0x605C, 0x605D)},
}
"""Objects beside its process data: the modes that it has, csp, csv and cst, and its option codes."""

DRIVE = record(
    ("present", "i8"),
    ("control_at", "i8"),
    ("mode_at", "i8"),
    ("target_at", "i8"),
    ("target_bytes", "i8"),
    ("target_number", "i8"),
    ("status_at", "i8"),
    ("shown_at", "i8"),
    ("error_at", "i8"),
    ("actual_at", "i8"),
    ("connection_lost", "i8"),
    ("quick_stop", "i8"),
    ("fault_reaction", "i8"),
    ("rest", "f8"),
    ("window", "f8"),
    ("state", "i8"),
    ("since_ns", "i8"),
    ("stepped_ns", "i8"),
    ("control", "i8"),
    ("mode", "i8"),
    ("target", "f8"),
    ("error", "i8"),
    ("out", "f8"),
    ("position", "f8"),
    ("fell_from", "f8"),
    ("fell_ns", "i8"),
    ("kept_up_ns", "i8"),
    ("fault", "i8"),
    ("fault_lasts", "i8"),
    ("torque_off", "i8"),
    ("refuses", "i8"),
    ("stuck", "i8"),
    ("wrong_mode", "i8"),
)
"""Where its objects lie in outputs and inputs, the option codes, where it rests (counts), how far it may lag (counts);
its state; and what is wrong with it: a fault code, safe torque off, no enabling, no moving, another mode shown."""


def fill_drive(drives: Any, k: int, terminal: Terminal) -> None:
    """Set up the record of terminal `k` as one that is a drive, as its PDOs are from the start; or as none."""
    drives[k] = np.zeros(1, DRIVE)[0]
    d = drives[k]
    if not terminal.is_drive:
        return
    outputs, inputs = _places(terminal.outputs), _places(terminal.inputs)
    target = next(index for index in _TARGETS if index in outputs)
    d["present"], d["window"] = 1, 1e4
    d["control_at"], d["mode_at"] = outputs[0x6040][0], outputs[0x6060][0]
    d["target_at"], d["target_bytes"] = outputs[target]
    d["target_number"] = list(outputs).index(target)
    d["status_at"], d["shown_at"], d["error_at"] = inputs[0x6041][0], inputs[0x6061][0], inputs[0x603F][0]
    d["actual_at"] = inputs.get(0x6064, (-1, 0))[0]
    take_codes(d, OBJECTS)


def take_codes(d: Any, settings: Mapping[tuple[int, int], bytes]) -> None:
    """Go by the option codes that a master has written."""
    if d["present"]:
        for name, (index, _) in _CODES.items():
            d[name] = struct.unpack("<h", settings[index, 0])[0]


def _places(pdos: Any) -> dict[int, tuple[int, int]]:
    """First byte and length of each object, by its index."""
    places, at = {}, 0
    for entries in pdos.values():
        for entry in entries:
            places[entry.index] = at, entry.bits // 8
            at += entry.bits // 8
    return places


@compiled.entry(types.void(array_of(DRIVE), array_of(ESC), types.int64))
def step_drives(drives: Any, slaves: Any, now_ns: int) -> None:
    """Let time pass in every drive: take its words from its slave's outputs, and put what it says into the inputs."""
    for k in range(len(drives)):
        d, slave = drives[k], slaves[k]
        if d["present"] == 0:
            continue
        if slave["powered"] == 0:
            enter(d, NOT_READY, now_ns)
            d["error"] = d["control"] = 0
            d["since_ns"] = now_ns
        operates = slave["powered"] != 0 and int(slave["memory"][AL_STATUS]) & STATUS_MASK == OP
        before = d["control"]
        take_words(d, slave["memory"][OUTPUTS:], operates)
        if not operates:
            lose_connection(d, now_ns)
        move_on(d, d["control"] & _RESET != 0 and before & _RESET == 0, now_ns)
        put_out(d, now_ns)
        say(d, slave["memory"][INPUTS:], now_ns)


@compiled
def take_words(d: Any, memory: Any, operates: Any) -> None:
    """Controlword, mode and target; without process data the drive is told nothing."""
    d["control"] = d["mode"] = 0
    if operates:
        d["control"] = np.int64(bits_at(memory, d["control_at"], 2, 0))
        d["mode"] = signed(bits_at(memory, d["mode_at"], 1, 0), 1)
        d["target"] = float(signed(bits_at(memory, d["target_at"], d["target_bytes"], 0), d["target_bytes"]))


@compiled
def signed(bits: Any, size: int) -> int:
    """The two's complement number of `size` bytes."""
    number, whole = int(bits), 1 << (8 * size)
    return number - whole if number >= whole >> 1 else number


@compiled
def enter(d: Any, state: int, now_ns: int) -> None:
    """Change the state; whatever loses its power there begins to fall."""
    had_power = d["state"] in (ENABLED, QUICK_STOP, REACTION)
    if had_power and state not in (ENABLED, QUICK_STOP, REACTION):
        d["fell_from"], d["fell_ns"] = d["out"], now_ns
    if state != d["state"]:
        d["state"], d["since_ns"] = state, now_ns
    d["kept_up_ns"] = now_ns


@compiled
def lose_connection(d: Any, now_ns: int) -> None:
    """What it does by itself without process data, as 0x6007 says."""
    if d["state"] != ENABLED:
        return
    if d["connection_lost"] == 2:
        enter(d, SWITCH_ON_DISABLED, now_ns)
    elif d["connection_lost"] == 3:
        enter(d, QUICK_STOP, now_ns)
    else:
        fail(d, _COMMUNICATION, now_ns)


@compiled
def fail(d: Any, code: int, now_ns: int) -> None:
    """Transition 13, where there is power to be led away, else right into the fault."""
    d["error"] = code
    reacts = d["state"] in (ENABLED, QUICK_STOP) and d["fault_reaction"] != 0
    enter(d, REACTION if reacts else FAULT, now_ns)


@compiled
def move_on(d: Any, reset: Any, now_ns: int) -> None:
    """The transitions."""
    state, control, passed_ns = d["state"], d["control"], now_ns - d["since_ns"]
    no_voltage, stop_quickly, shut_down = control & 2 == 0, control & 6 == 2, control & 7 == 6
    switch_on, enable = control & 15 == 7, control & 15 == 15
    if d["fault"] != 0 and state != FAULT and state != REACTION and state != NOT_READY:
        fail(d, d["fault"], now_ns)
        if d["fault_lasts"] == 0:
            d["fault"] = 0
    elif state == NOT_READY:
        if passed_ns >= _SELF_TEST_NS:
            enter(d, SWITCH_ON_DISABLED, now_ns)
    elif state == REACTION:
        if passed_ns >= _STOPPING_NS:
            enter(d, FAULT, now_ns)
    elif state == FAULT:
        if reset and d["fault"] == 0:
            d["error"] = 0
            enter(d, SWITCH_ON_DISABLED, now_ns)
    elif state == SWITCH_ON_DISABLED:
        if shut_down and d["torque_off"] == 0:
            enter(d, READY, now_ns)
    elif no_voltage or d["torque_off"] != 0:
        enter(d, SWITCH_ON_DISABLED, now_ns)
    elif state == QUICK_STOP:
        if passed_ns >= _STOPPING_NS:
            enter(d, SWITCH_ON_DISABLED, now_ns)
    elif stop_quickly:
        enter(d, QUICK_STOP if state == ENABLED and d["quick_stop"] != 0 else SWITCH_ON_DISABLED, now_ns)
    elif state == READY:
        if switch_on or enable:
            enter(d, SWITCHED_ON, now_ns)
    elif shut_down:
        enter(d, READY, now_ns)
    elif state == SWITCHED_ON:
        if enable and d["refuses"] == 0:
            enter(d, ENABLED, now_ns)
    elif switch_on:
        d["fell_from"], d["fell_ns"] = d["out"], now_ns
        enter(d, SWITCHED_ON, now_ns)


@compiled
def put_out(d: Any, now_ns: int) -> None:
    """What is in force now, and where that has led."""
    passed_ns, d["stepped_ns"] = now_ns - d["stepped_ns"], now_ns
    if d["state"] == ENABLED:
        if d["stuck"] == 0:
            d["out"] = d["target"]
        if abs(d["target"] - d["out"]) <= d["window"]:
            d["kept_up_ns"] = now_ns
    elif d["state"] not in (QUICK_STOP, REACTION):
        left = max(0.0, 1.0 - float(now_ns - d["fell_ns"]) / float(_FALLING_NS))
        d["out"] = d["rest"] + (d["fell_from"] - d["rest"]) * left
    if d["mode"] == _POSITION or d["state"] != ENABLED:
        d["position"] = d["out"] if d["actual_at"] >= 0 else d["position"]
    else:
        d["position"] += d["out"] * 1e-9 * float(passed_ns)


@compiled
def say(d: Any, memory: Any, now_ns: int) -> None:
    """Its inputs."""
    status = d["state"] | _REMOTE | (0 if d["torque_off"] != 0 else _VOLTAGE)
    if d["state"] == ENABLED:
        lags = now_ns - d["kept_up_ns"] > _PATIENCE_NS
        status |= _TAKES_TARGET | (_LAGS if lags else 0)
    put_bits(memory, d["status_at"], 2, 0, np.uint64(status))
    shown = _HOMING if d["wrong_mode"] != 0 else d["mode"]
    put_bits(memory, d["shown_at"], 1, 0, np.uint64(shown & 0xFF))
    put_bits(memory, d["error_at"], 2, 0, np.uint64(d["error"]))
    if d["actual_at"] >= 0:
        position = np.int64(np.rint(d["position"]))
        put_bits(memory, d["actual_at"], 4, 0, np.uint64(position & 0xFFFF_FFFF))
