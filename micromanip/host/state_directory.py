"""Where a controller keeps what outlives it: its audit trail, its trips, what it has learned."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from micromanip.files import own_temporary_folder

if TYPE_CHECKING:
    from micromanip.settings.schema.learning import Learning


def state_directory() -> Path:
    """What systemd gives by StateDirectory=, else the user's own as the XDG base directories say.

    A user without a home has a temporary one; raises PermissionDenied where somebody else has put it there.
    """
    if given := os.environ.get("STATE_DIRECTORY"):
        return Path(given.split(":")[0])
    base = os.environ.get("XDG_STATE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".local" / "state") / "micromanip"
    except RuntimeError:  # a user without a home
        return own_temporary_folder() / "state"


def memory_folder(wanted: Learning, configuration: Path) -> Path:
    """Where the memories are that `wanted`, in the file `configuration`, speaks of."""
    folder = wanted.folder
    return state_directory() / "learned" if folder is None else configuration.absolute().parent / folder
