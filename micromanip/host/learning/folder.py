"""Where the memories of a configuration are."""

from __future__ import annotations

from pathlib import Path

from micromanip.host.state_directory import state_directory
from micromanip.settings.schema.learning import Learning


def memory_folder(wanted: Learning, configuration: Path) -> Path:
    """The folder of the memories that `wanted`, in the file `configuration`, speaks of."""
    return state_directory() / "learned" if wanted.folder is None else configuration.absolute().parent / wanted.folder
