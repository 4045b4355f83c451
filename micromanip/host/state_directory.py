"""Where a controller keeps what outlives it: its audit trail."""

from __future__ import annotations

import os
from pathlib import Path


def state_directory() -> Path:
    """What systemd gives by StateDirectory=, else the user's own as the XDG base directories say."""
    if given := os.environ.get("STATE_DIRECTORY"):
        return Path(given.split(":")[0])
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "micromanip"
