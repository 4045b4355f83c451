"""What comes with the program beside its code: example configurations, units of systemd."""

from __future__ import annotations

import sysconfig
from pathlib import Path

import micromanip

_PLACE = Path("share", "micromanip")


def shipped(folder: str) -> Path:
    """Where `folder` of the source tree is here: in the tree itself, or where the installation put it."""
    assert micromanip.__file__ is not None
    tree = Path(micromanip.__file__).resolve().parent.parent
    if (tree / "pyproject.toml").is_file():
        return tree / folder
    return Path(sysconfig.get_path("data")) / _PLACE / folder
