"""A process that works for one who serves: it gives way to everybody, and is the first to go where memory ends."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def give_way() -> None:
    """As far as it may: a service may be forbidden to change its priority, and has a low one then."""
    with contextlib.suppress(OSError):
        os.nice(10)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
