"""The states of a slave's application layer (AL), and what it says when it refuses one (ETG.1020)."""

from __future__ import annotations

INIT, PREOP, BOOT, SAFEOP, OP = 1, 2, 3, 4, 8
STATE_MASK, ERROR, STATUS_MASK = 0x0F, 0x10, 0x1F
"""Of AL status: the state; the flag that the slave has refused or left one, which AL control acknowledges; both."""
STATE_NAMES = {INIT: "INIT", PREOP: "PREOP", BOOT: "BOOT", SAFEOP: "SAFEOP", OP: "OP"}

INVALID_CHANGE, UNKNOWN_STATE, NO_BOOT = 0x0011, 0x0012, 0x0013
INVALID_MAILBOX, WATCHDOG, INVALID_OUTPUTS, INVALID_INPUTS = 0x0016, 0x001B, 0x001D, 0x001E
NO_SYNC, BAD_CLOCK, BAD_SYNC_CYCLE = 0x002D, 0x0030, 0x0035

_CODES = {
    0x0001: "unspecified error",
    0x0002: "no memory",
    0x0003: "invalid device set-up",
    0x0011: "invalid requested state change",
    0x0012: "unknown requested state",
    0x0013: "bootstrap not supported",
    0x0014: "no valid firmware",
    0x0015: "invalid mailbox configuration (bootstrap)",
    0x0016: "invalid mailbox configuration",
    0x0017: "invalid sync manager configuration",
    0x0018: "no valid inputs available",
    0x0019: "no valid outputs",
    0x001A: "synchronisation error",
    0x001B: "sync manager watchdog: no outputs came in time",
    0x001C: "invalid sync manager types",
    0x001D: "invalid output configuration: length of the process data",
    0x001E: "invalid input configuration: length of the process data",
    0x001F: "invalid watchdog configuration",
    0x0020: "needs a cold start",
    0x0021: "needs INIT",
    0x0022: "needs PREOP",
    0x0023: "needs SAFEOP",
    0x0024: "invalid input mapping",
    0x0025: "invalid output mapping",
    0x0026: "inconsistent settings",
    0x0027: "free run not supported",
    0x0028: "synchronous mode not supported",
    0x0029: "free run needs three buffers",
    0x002A: "background watchdog",
    0x002B: "no valid inputs and outputs",
    0x002C: "fatal synchronisation error: SYNC0 or SYNC1 has stopped",
    0x002D: "no synchronisation: SYNC0 has not begun",
    0x0030: "invalid configuration of the distributed clock",
    0x0031: "invalid latch configuration of the distributed clock",
    0x0032: "phase-locked loop error",
    0x0033: "input and output error of the distributed clock",
    0x0034: "time-out of the distributed clock",
    0x0035: "invalid cycle time of the distributed clock",
    0x0050: "no access to the EEPROM",
    0x0051: "EEPROM error",
    0x0060: "restarted locally",
    0x0061: "device identification has changed",
}


def al_code_in_words(code: int) -> str:
    """What an AL status code means."""
    return _CODES.get(code, "of the manufacturer, see its manual" if code >= 0x8000 else "unknown")


def state_name(status: int) -> str:
    """The state in AL status, in words."""
    name = STATE_NAMES.get(status & STATE_MASK, f"unknown state {status & STATE_MASK}")
    return f"{name} with an error" if status & ERROR else name
