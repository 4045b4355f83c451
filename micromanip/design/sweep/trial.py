"""One tuning tried on every recording, which are read, cut and fitted once before."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import ConfigError, UsageError, did_you_mean
from micromanip.replay.counterfactual import Rerun
from micromanip.replay.fitting import Models
from micromanip.replay.window import Window
from micromanip.settings.check import Prepared, prepared, validate
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.text.keys import assigned, key_path
from micromanip.settings.text.source import Source

from .space import Space, for_axes
from .work import Tried


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


def require_keys(trials: Trials) -> None:
    """Raise UsageError for a key that is not there, no number, or no part of a tuning."""
    known = trials.base.configuration.model_dump(mode="json")
    axes = list(trials.base.configuration.axes)
    for dimension in trials.space.dimensions:
        for key in for_axes({dimension.key: 0.0}, axes):
            _require_key(known, key, f"{dimension.origin} {key}")


def _require_key(known: Any, key: str, told: str) -> None:
    place: Any = known
    for part in key_path(key):
        inside = isinstance(place, list) and isinstance(part, int) and part < len(place)
        if not inside and not (isinstance(place, dict) and part in place):
            there = place if isinstance(place, dict) else ()
            raise UsageError(f"{told}: there is no {part}; {did_you_mean(str(part), there)}")
        place = place[part]
    if key.partition(".")[0] not in ("axes", "reference"):
        raise UsageError(f"{told}: only axes and reference are a tuning; the rest is another cell")
    if isinstance(place, bool) or not isinstance(place, int | float):
        raise UsageError(f"{told}: it is {place!s:.40}, and no number to be drawn")
