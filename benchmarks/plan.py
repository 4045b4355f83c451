"""What a run of the benchmarks is told: which configuration, how long, and whom to tell how far it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Plan:
    """Settings of all benchmarks."""

    configuration: Path
    pairs: int
    """Interleaved pairs of ours and the reference in `cycle` and `lateness`."""
    lateness_s: float
    """Length of one measurement of `lateness`."""
    tell: Callable[[str], None]
    """Gets one line for people now and then."""
