"""What stands apart and comes with an extra, and what to install where it is missing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from micromanip.errors import DeviceUnavailable


@contextlib.contextmanager
def required(what: str, extra: str) -> Iterator[None]:
    """Around the import of what `what`, an option, command or file, needs: DeviceUnavailable where it is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if (missing.name or "").startswith("micromanip"):
            raise
        raise DeviceUnavailable(f"{what} needs {missing.name}: {advice(extra)}") from missing


def advice(extra: str) -> str:
    """What to do where a package of `extra` is missing."""
    return f"install micromanip with its extra {extra} (in the folder of its source: pip install '.[{extra}]')"
