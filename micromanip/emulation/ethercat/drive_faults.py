"""What befalls a drive, put into its record, and taken out of it again."""

from __future__ import annotations

from typing import Any

from micromanip.errors import UsageError

from .faults import DriveFault, OfDrive

_FIELDS = {"torque_off": "torque_off", "refuses": "refuses", "stuck": "stuck", "mode": "wrong_mode", "fault": "fault"}


def befall_drive(d: Any, fault: OfDrive) -> None:
    """Let it happen from now on. Raises UsageError for a terminal that is no drive."""
    kind: str = fault.kind
    if not d["present"]:
        raise UsageError(f"fault {kind}: terminal {fault.terminal} is no drive")
    d[_FIELDS[kind]] = fault.code if isinstance(fault, DriveFault) else 1
    d["fault_lasts"] = int(fault.for_s is not None)


def relieve(d: Any, kind: str | None = None) -> None:
    """End one kind of fault, or all."""
    for each, name in _FIELDS.items():
        if kind in (None, each):
            d[name] = 0
