"""What a drive says, in words: its state, and its error code by the classes of CiA 402 (IEC 61800-7-201)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from .drive_records import FAULT, FAULT_REACTION, FAULTED, LATE, LEFT, LOST, NOTHING, OPERATION, STAYS
from .options import EthercatOptions

STATE_NAMES = (
    "Not ready to switch on",
    "Switch on disabled",
    "Ready to switch on",
    "Switched on",
    "Operation enabled",
    "Quick stop active",
    "Fault reaction active",
    "Fault",
    "no state of CiA 402",
)
_CODES = {
    0x1000: "generic error",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x2330: "earth leakage",
    0x2340: "short circuit",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "phase failure",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3310: "output over-voltage",
    0x4110: "excess ambient temperature",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x5112: "supply low voltage",
    0x5530: "error of the non-volatile memory",
    0x6320: "parameter error",
    0x7110: "brake chopper",
    0x7121: "motor blocked",
    0x7305: "incremental sensor 1",
    0x7500: "communication",
    0x8110: "process data overrun",
    0x8130: "heartbeat or life guard error",
    0x8311: "excess torque",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronisation control",
    0x9000: "external error",
}
_CLASSES = {
    0x1000: "generic error",
    0x2000: "current",
    0x2300: "current on the device's output side",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3200: "DC link voltage",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x5000: "device hardware",
    0x5100: "supply of the device",
    0x6000: "device software",
    0x6300: "data record",
    0x7000: "additional modules",
    0x7300: "sensor",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8600: "positioning controller",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "of its maker's own",
}
_VOLTAGE_ON, _REMOTE, _TAKES_TARGET, _FOLLOWING_ERROR = 1 << 4, 1 << 9, 1 << 12, 1 << 13


def error_in_words(code: int) -> str:
    """What 0x603F says: the code, or the class that it belongs to."""
    for known in (_CODES.get(code), _CLASSES.get(code & 0xFF00), _CLASSES.get(code & 0xF000)):
        if known is not None:
            return known
    return "no error" if code == 0 else "an unknown error"


class DriveWords:
    """Of the drives of one context, a record in memory that the loop writes."""

    def __init__(self, options: EthercatOptions, context: Any) -> None:
        self._names, self._context = list(options.drives), context
        self._line = f"ethercat {options.interface}"
        self._told = [""] * len(self._names)
        self._ends = [0] * len(self._names)

    def news(self) -> Iterator[str]:
        """What has changed since the last time and is to be told."""
        for k, name in enumerate(self._names):
            d = self._context["drive"][k]
            number = int(d["end"]["number"])
            for said in (in_words(d, d["end"]), in_words(d, d)) if number != self._ends[k] else (in_words(d, d),):
                if said and said != self._told[k]:
                    yield f"{self._line}: drive {name} {said}"
                self._told[k] = said
            self._ends[k] = number


def in_words(d: Any, at: Any) -> str:
    """Why a drive is not as it is asked to be, `at` a moment: its record, or its ``end``; nothing where it is."""
    why, state = int(at["why"]), int(at["state"])
    if state in (FAULT, FAULT_REACTION):
        code = int(at["error"])
        left = "left Operation enabled and " if why == LEFT else ""
        return (
            f"{left}is in {STATE_NAMES[state]}: {error_in_words(code)} (0x{code:04x}); once the cause is gone: "
            "`micromanip reset`, if its key reset names a switch"
        )
    now = f"{STATE_NAMES[state]} (statusword 0x{int(at['status']):04x})"
    if why == LEFT:
        return f"left Operation enabled: {_what_is_amiss(d, at) or 'nobody here asked for that'}; it is in {now}"
    if why == FAULTED:
        return f"had a fault when it was to be enabled; it is in {now}"
    if why == LATE:
        limit_ms = 1e-6 * float(d["enable_ns"])
        return f"was not enabled within {limit_ms:g} ms: {_what_is_amiss(d, at) or 'it refuses'}; it is in {now}"
    if why == STAYS:
        return f"does not stop: {1e-6 * float(d['stop_ns']):g} ms after the command, it is in {now}"
    assert why in (NOTHING, LOST)
    return ""


def _what_is_amiss(d: Any, at: Any) -> str:
    """The first thing by which a drive can't operate."""
    status = int(at["status"])
    if int(at["shown_mode"]) != int(d["mode"]):
        return f"it shows mode {int(at['shown_mode'])} instead of {int(d['mode'])}"
    if not at["fits"]:
        return f"its position, {float(at['actual']):g}, is outside of the target's range"
    if int(at["state"]) == OPERATION:
        if not status & _TAKES_TARGET:
            return "it does not follow its target (bit 12)"
        if d["tells_following_error"] and status & _FOLLOWING_ERROR:
            return "following error (bit 13)"
        return "its target has not been taken up yet: take_up_V_per_s is too small for the way"
    if not status & _VOLTAGE_ON:
        return "it has no main power (bit 4): safe torque off?"
    return "" if status & _REMOTE else "it takes no controlwords (bit 9): is its own panel in control?"
