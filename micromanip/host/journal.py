"""Faults as structured entries of the systemd journal: its native protocol, a datagram an entry.

    journalctl -u micromanip MICROMANIP_CODE=X-201
    journalctl MESSAGE_ID=0abd6dde16004fdd95f7b63ab967704c -o verbose

Every message of a service goes there with its priority; a trip has its figures as fields.
"""

from __future__ import annotations

import math
import os
import re
import socket
import struct
from collections.abc import Mapping
from pathlib import Path

SOCKET = Path("/run/systemd/journal/socket")
TRIP = "0abd6dde16004fdd95f7b63ab967704c"
"""MESSAGE_ID of every latched fault."""
_CRITICAL, _ERROR, _WARNING, _INFO = 2, 3, 4, 6
_STANDARD_ERROR = 2
_FAULT = re.compile(r"(?P<code>[XW]-\d+)(?: axis (?P<axis>\w+):)?")


def is_connected() -> bool:
    """Whether standard error goes to the journal: systemd names device and inode of that stream."""
    try:
        device, inode = os.environ["JOURNAL_STREAM"].split(":")
        found = os.fstat(_STANDARD_ERROR)
    except (KeyError, ValueError, OSError):
        return False
    return (str(found.st_dev), str(found.st_ino)) == (device, inode)


def entry(fields: Mapping[str, str]) -> bytes:
    """One datagram: ``NAME=value`` lines; a value of several lines goes with its length in front."""
    lines = []
    for name, value in fields.items():
        content = value.encode()
        if b"\n" in content:
            lines.append(name.encode() + b"\n" + struct.pack("<Q", len(content)) + content + b"\n")
        else:
            lines.append(name.encode() + b"=" + content + b"\n")
    return b"".join(lines)


def send(fields: Mapping[str, str], path: Path = SOCKET) -> bool:
    """Hand an entry to the journal; False where nobody takes it at once. Never blocks."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        try:
            sender.sendto(entry(fields), str(path))
        except OSError:
            return False
    return True


def message_fields(message: str) -> dict[str, str]:
    """Fields of a plain message: text and priority; code and axis where it tells of a fault."""
    fault = _FAULT.match(message)
    priority = _WARNING if message.startswith(("WARNING", "W-")) else _ERROR if fault else _INFO
    fields = {"MESSAGE": message, "PRIORITY": str(priority), "SYSLOG_IDENTIFIER": "micromanip"}
    if fault:
        fields |= {f"MICROMANIP_{name.upper()}": value for name, value in fault.groupdict().items() if value}
    return fields


def trip_fields(
    message: str, code: str, axis: str | None, value: float | None, limit: float | None, trip: str | None
) -> dict[str, str]:
    """Fields of a latched fault; what is not known is left out."""
    known = {
        "MICROMANIP_CODE": code,
        "MICROMANIP_AXIS": axis,
        "MICROMANIP_VALUE": _number(value),
        "MICROMANIP_LIMIT": _number(limit),
        "MICROMANIP_TRIP": trip,
    }
    fields = {"MESSAGE": message, "PRIORITY": str(_CRITICAL), "MESSAGE_ID": TRIP, "SYSLOG_IDENTIFIER": "micromanip"}
    return fields | {name: value for name, value in known.items() if value is not None}


def _number(value: float | None) -> str | None:
    return None if value is None or not math.isfinite(value) else f"{value:.9g}"
