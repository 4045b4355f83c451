"""One tuning tried on every recording: what a worker does, with all that it needs in one file.

The recordings are read, cut and fitted once, before; each worker loads the result once.
"""

from __future__ import annotations

import functools
import math
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import ConfigError, UsageError
from micromanip.replay.counterfactual import Rerun
from micromanip.replay.fitting import Models
from micromanip.replay.window import Window
from micromanip.settings.check import Prepared, prepared, validate
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.source import Source

from .space import Space, for_axes


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


@dataclass(frozen=True)
class Trials:
    """What is varied about the tuning `source`, and the recordings."""

    source: Source
    space: Space
    pieces: list[tuple[Window, Models]]

    @functools.cached_property
    def reruns(self) -> list[Rerun]:
        """The recordings, each with room for its rows."""
        return [Rerun(window, models) for window, models in self.pieces]

    @functools.cached_property
    def base(self) -> Prepared:
        """The tuning itself."""
        return prepared(self.source)

    @functools.cached_property
    def _known(self) -> dict[str, Any]:
        return self.base.configuration.model_dump(mode="json")

    def tuned(self, number: int) -> Source:
        """Document of tuning `number`; UsageError where a key is not there."""
        values = for_axes(self.space.values(number), list(self.base.configuration.axes))
        return Source.of(assigned(self.source.data, self._known, values), self.source.path)

    def parameters(self, number: int) -> NDArray[Any]:
        """Its set (1,); raises ConfigError or LinAlgError, ValueError, FloatingPointError where there is none."""
        return np.asarray(compile_cell(validate(self.tuned(number)), self.base.wiring))

    def tried(self, number: int) -> Tried:
        """It, tried on every recording."""
        values = self.space.values(number)
        try:
            parameters = self.parameters(number)
        except (ConfigError, np.linalg.LinAlgError, ValueError, FloatingPointError) as problem:
            return Tried(number, values, problem=str(problem).partition("\n")[0])
        figures, stopped = [], 0
        for rerun in self.reruns:
            rows = rerun.rows(parameters)
            stopped += rerun.tracked(rows) < len(rows)
            figures.append(rerun.figures(rows))
        if stopped:
            return Tried(number, values, stopped=stopped)
        rms = np.sqrt(np.mean(np.array(figures)[:, 0] ** 2, axis=0))
        _, p99, peak = np.max(figures, axis=0)
        cost_um = math.sqrt(float(np.mean(rms**2)))
        return Tried(number, values, cost_um, tuple(rms.tolist()), tuple(p99.tolist()), tuple(peak.tolist()))


@dataclass(frozen=True)
class Work:
    """Trials as they go to workers: a file on this machine, or its content where workers are on others."""

    name: str
    file: Path | None = None
    content: bytes | None = None

    def load(self) -> Trials:
        """The trials; kept in this process until others are asked for."""
        if self.name not in _loaded:
            _loaded.clear()
            content = self.content if self.file is None else self.file.read_bytes()
            assert content is not None
            _loaded[self.name] = pickle.loads(content)
        return _loaded[self.name]


_loaded: dict[str, Trials] = {}


def try_some(work: Work, numbers: list[int]) -> list[Tried]:
    """The tunings `numbers`, in their order."""
    trials = work.load()
    return [trials.tried(number) for number in numbers]


def require_keys(trials: Trials) -> None:
    """Raise UsageError for a key that is not there, or no number."""
    known = trials.base.configuration
    for dimension in trials.space.dimensions:
        for key in for_axes({dimension.key: 0.0}, list(known.axes)):
            assigned(trials.source.data, known.model_dump(mode="json"), {key: dimension.low})
            if key.partition(".")[0] not in ("axes", "reference"):
                raise UsageError(f"--vary {key}: only axes and reference are a tuning; the rest is another cell")
