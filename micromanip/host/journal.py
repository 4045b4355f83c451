"""Messages to the system's journal as structured entries, where standard error leads there: a service's run.

The journal's native protocol: a datagram of ``FIELD=value`` lines. ``journalctl MICROMANIP_CODE=X-105`` then finds each
time that the loop stood still, and a message's priority colours it.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Mapping
from pathlib import Path

SOCKET = Path("/run/systemd/journal/socket")

_ERROR, _WARNING, _INFO = 3, 4, 6
_FAULT = re.compile(r"(?P<code>X-\d+)(?: axis (?P<axis>\w+):)?")


def leads_to_journal(descriptor: int = 2, environment: Mapping[str, str] = os.environ) -> bool:
    """Is `descriptor` the stream that the service manager connected to the journal, not redirected since?"""
    try:
        found = os.fstat(descriptor)
    except OSError:
        return False
    return environment.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def fields(message: str) -> dict[str, str]:
    """Fields of one message: text and priority; code and axis of a fault."""
    fault = _FAULT.match(message)
    priority = _ERROR if fault else _WARNING if message.startswith("WARNING") else _INFO
    entry = {"MESSAGE": " ".join(message.splitlines()), "PRIORITY": str(priority), "SYSLOG_IDENTIFIER": "micromanip"}
    if fault:
        entry["MICROMANIP_CODE"] = fault["code"]
        if fault["axis"]:
            entry["MICROMANIP_AXIS"] = fault["axis"]
    return entry


def send(message: str, path: Path = SOCKET) -> bool:
    """Send one message; False where the journal does not take it, and it must be told otherwise."""
    lines = "".join(f"{name}={value}\n" for name, value in fields(message).items())
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        try:
            out.sendto(lines.encode(errors="replace"), str(path))
        except OSError:
            return False
    return True
