"""What comes with an extra, and which one to install where it is missing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from micromanip.errors import UsageError


@contextlib.contextmanager
def require_gateway(command: str) -> Iterator[None]:
    """Around the import of the gateway; UsageError where the extra is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if (missing.name or "").startswith("micromanip"):
            raise
        raise UsageError(
            f"{command} needs {missing.name}, which comes with the extra: pip install 'micromanip[gateway]'"
        ) from missing
