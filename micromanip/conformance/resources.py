"""What this process holds at the moment: descriptors, threads, memory maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self


def descriptors() -> int:
    """Open descriptors of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


@dataclass(frozen=True)
class Held:
    """Counts of what a leak adds to."""

    descriptors: int
    threads: int
    maps: int

    @classmethod
    def now(cls) -> Self:
        """As the kernel sees it."""
        maps = Path("/proc/self/maps").read_bytes().count(b"\n")
        return cls(descriptors(), len(list(Path("/proc/self/task").iterdir())), maps)
