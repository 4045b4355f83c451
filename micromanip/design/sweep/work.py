"""What goes to a worker and comes back: all that it needs in one file, which it loads once, and what it found.

A worker imports this first, and the rest as it loads what it is to do.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class Tried:
    """A tuning and its path error over all recordings (um); None where the cell would have stopped, or it is refused.

    `cost_um` is the rms over all axes and recordings, `rms_um`, `p99_um` and `peak_um` are per axis: rms over the
    recordings, the largest of the others. `stopped` counts the recordings on which it stops, `problem` is why the
    configuration's own check refuses it.
    """

    number: int
    values: dict[str, float]
    cost_um: float | None = None
    rms_um: tuple[float, ...] = ()
    p99_um: tuple[float, ...] = ()
    peak_um: tuple[float, ...] = ()
    stopped: int = 0
    problem: str = ""


class Tries(Protocol):
    """Whoever tries a tuning: `trial.Trials`."""

    def tried(self, number: int) -> Tried:
        """The tuning of that number, tried."""


@dataclass(frozen=True)
class Work:
    """Trials as they go to workers: a file on this machine, or its content where workers are on others."""

    name: str
    file: Path | None = None
    content: bytes | None = None

    def load(self) -> Tries:
        """The trials; kept in this process until others are asked for."""
        if self.name not in _loaded:
            _loaded.clear()
            content = self.content if self.file is None else self.file.read_bytes()
            assert content is not None
            _loaded[self.name] = pickle.loads(content)
        return _loaded[self.name]


_loaded: dict[str, Tries] = {}


def try_some(work: Work, numbers: list[int]) -> list[Tried]:
    """The tunings `numbers`, in their order."""
    trials = work.load()
    return [trials.tried(number) for number in numbers]
