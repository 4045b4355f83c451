"""Import paths of before the door ``micromanip.driver``, for one version: they work, and say what is right."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from types import ModuleType
from typing import Any


def stand_in(package: str, moved: dict[str, tuple[str, str]]) -> None:
    """Modules of `package` that have moved: old name to where its names stand, and to what to import instead.

    What stands there is imported when a name is asked for, with a DeprecationWarning at the place that asks.
    """
    for old, (real, door) in moved.items():
        module = sys.modules[f"{package}.{old}"] = ModuleType(f"{package}.{old}", f"Moved to {door}.")
        module.__getattr__ = _asked(module.__name__, real, door)  # type: ignore[method-assign]


def _asked(old: str, real: str, door: str) -> Any:
    def ask(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        found = getattr(import_module(real), name)
        warnings.warn(f"{old} has moved: import {name} from {door}", DeprecationWarning, stacklevel=2)
        return found

    return ask
