"""Faults as structured entries of the systemd journal: its native protocol, a datagram an entry.

    journalctl -u micromanip MICROMANIP_CODE=X-201
    journalctl MESSAGE_ID=0abd6dde16004fdd95f7b63ab967704c -o verbose

Every message of a service goes there with its priority; a trip has its figures as fields.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping
from pathlib import Path

from micromanip.faults import FaultReport

from .notify import send_datagram

SOCKET = Path("/run/systemd/journal/socket")
TRIP = "0abd6dde16004fdd95f7b63ab967704c"
"""MESSAGE_ID of every latched fault."""
_CRITICAL, _WARNING, _INFO = 2, 4, 6
_STANDARD_ERROR = 2


def is_connected() -> bool:
    """Whether standard error goes to the journal: systemd names device and inode of that stream."""
    try:
        device, inode = os.environ["JOURNAL_STREAM"].split(":")
        found = os.fstat(_STANDARD_ERROR)
    except (KeyError, ValueError, OSError):
        return False
    return (str(found.st_dev), str(found.st_ino)) == (device, inode)


def entry(found: Mapping[str, str]) -> bytes:
    """One datagram: ``NAME=value`` lines; a value of several lines goes with its length in front."""
    lines = []
    for name, value in found.items():
        content = value.encode()
        if b"\n" in content:
            lines.append(name.encode() + b"\n" + struct.pack("<Q", len(content)) + content + b"\n")
        else:
            lines.append(name.encode() + b"=" + content + b"\n")
    return b"".join(lines)


def send(found: Mapping[str, str], path: Path = SOCKET) -> bool:
    """Hand an entry to the journal; False where nobody takes it at once."""
    return send_datagram(str(path), entry(found))


def fields(told: str | FaultReport) -> dict[str, str]:
    """Fields of a message, or of a fault: its text and priority, and what is known of a fault's figures."""
    found = {"MESSAGE": str(told), "PRIORITY": str(_INFO), "SYSLOG_IDENTIFIER": "micromanip"}
    if not isinstance(told, FaultReport):
        return found | {"PRIORITY": str(_WARNING)} if told.startswith("WARNING") else found
    known = {"CODE": told.kind.code, "AXIS": told.axis, "TRIP": told.box}
    known |= {"VALUE": _number(told.value), "LIMIT": _number(told.limit)}
    found |= {f"MICROMANIP_{name}": value for name, value in known.items() if value is not None}
    if told.kind.is_warning:
        return found | {"PRIORITY": str(_WARNING)}
    return found | {"PRIORITY": str(_CRITICAL), "MESSAGE_ID": TRIP}


def _number(value: float) -> str | None:
    return f"{value:.9g}" if math.isfinite(value) else None
