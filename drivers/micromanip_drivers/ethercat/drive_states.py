"""The power state machine of CiA 402 (IEC 61800-7-201): state by statusword, controlword by state."""

from __future__ import annotations

from typing import Any

from .compiled import compiled
from .drive_records import (
    FAULT,
    FAULT_REACTION,
    NOT_READY,
    OPERATION,
    QUICK_STOP,
    READY,
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
