"""Where a controller keeps what outlives it: its audit trail, its trips, its trend, what it has learned."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from micromanip.settings.schema.learning import Learning
    from micromanip.settings.schema.trend import Trend


def state_directory() -> Path:
    """What systemd gives by StateDirectory=, else the user's own as the XDG base directories say.

    A user without a home has a temporary one.
    """
    if given := os.environ.get("STATE_DIRECTORY"):
        return Path(given.split(":")[0])
    base = os.environ.get("XDG_STATE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".local" / "state") / "micromanip"
    except RuntimeError:  # a user without a home
        return Path(tempfile.gettempdir()) / f"micromanip-{os.geteuid()}" / "state"


def memory_folder(wanted: Learning, configuration: Path) -> Path:
    """Where the memories are that `wanted`, in the file `configuration`, speaks of."""
    return _below(configuration, wanted.folder, "learned")


def trend_folder(wanted: Trend, configuration: Path) -> Path:
    """The same of the days of a trend."""
    return _below(configuration, wanted.folder, "trend")


def _below(configuration: Path, folder: str | None, usual: str) -> Path:
    return state_directory() / usual if folder is None else configuration.absolute().parent / folder
