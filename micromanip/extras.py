"""What comes with an extra, and which one to install where it is missing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from micromanip.errors import UsageError


@contextlib.contextmanager
def required(what: str, extra: str) -> Iterator[None]:
    """Around the import of what the option or command `what` needs; UsageError where `extra` is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if (missing.name or "").startswith("micromanip"):
            raise
        raise UsageError(
            f"{what} needs {missing.name}, which comes with the extra: pip install 'micromanip[{extra}]'"
        ) from missing
