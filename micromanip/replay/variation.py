"""Many tunings on one recording: what is varied, and the path error that each tuning would have left.

Trial 0 is the tuning that is varied. A scrambled Halton sequence covers the ranges: seed and number determine a trial,
whoever computes it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.errors import ConfigError, UsageError
from micromanip.settings.change import leaves
from micromanip.settings.check import Prepared, revise, validate
from micromanip.settings.text.digits import rounded
from micromanip.settings.text.keys import assigned, selected
from micromanip.settings.text.source import Source

from .counterfactual import FIGURES, Rerun
from .fitting import Models
from .window import Window

_SYNTAX = "write KEY=LOW..HIGH, KEY=LOW..HIGH:log or KEY=VALUE,VALUE; axes.*. is every axis alike"


@dataclass(frozen=True)
class Variation:
    """A key with the values that it may take: those listed, or all between both ends, evenly (over the logarithm)."""

    key: str
    values: tuple[float, ...]
    is_range: bool = False
    log: bool = False

    @classmethod
    def parse(cls, text: str) -> Variation:
        """Of ``KEY=LOW..HIGH``, ``KEY=LOW..HIGH:log`` or ``KEY=VALUE,VALUE``; raises UsageError."""
        key, _, span = text.partition("=")
        ends, is_log, _ = span.partition(":log") if span.endswith(":log") else (span, "", "")
        is_range = ".." in ends or bool(is_log)
        try:
            values = tuple(map(float, ends.split("..", 1) if is_range else ends.split(",")))
        except ValueError:
            values = ()
        if not key.strip() or not values or not all(map(math.isfinite, values)):
            raise UsageError(f"--vary {text!r:.80}: {_SYNTAX}")
        if is_range and not (len(values) == 2 and values[0] < values[1]):
            raise UsageError(f"--vary {text!r:.80}: a range goes from a lower to a higher value")
        if is_log and values[0] <= 0.0:
            raise UsageError(f"--vary {text!r:.80}: a logarithmic range begins above 0")
        return cls(key.strip(), values, is_range, bool(is_log))

    def value(self, share: float) -> float:
        """The value at `share` (0..1) of the way, with the digits that a file has."""
        if not self.is_range:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        low, high = map(math.log, self.values) if self.log else self.values
        at = low + share * (high - low)
        return float(rounded(math.exp(at) if self.log else at))


def drawn(variations: Sequence[Variation], count: int, seed: int) -> list[dict[str, float]]:
    """Key -> value of trials 1 .. `count`; every combination instead where lists alone have no more.

    Raises UsageError for a key that is given twice.
    """
    keys = [each.key for each in variations]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise UsageError(f"--vary {twice} is given twice")
    listed = all(not each.is_range for each in variations)
    if listed and math.prod(len(each.values) for each in variations) <= count:
        return [dict(zip(keys, values, strict=True)) for values in itertools.product(*(v.values for v in variations))]
    from scipy.stats import qmc  # takes a second to import

    shares = qmc.Halton(len(keys), rng=seed).random(count)
    return [{each.key: each.value(share) for each, share in zip(variations, row, strict=True)} for row in shares]


@dataclass(frozen=True)
class Trial:
    """Values by key and the path error (um) per axis: rms, p99, peak (3, axes), empty where the trial has none.

    `cost_um` is the rms over all axes of the figure that is minimised; None where the cell `stopped`, or where `check`
    refuses the configuration for `problem`.
    """

    number: int
    values: dict[str, float]
    cost_um: float | None = None
    um: tuple[tuple[float, ...], ...] = ()
    stopped: bool = False
    problem: str = ""


@dataclass(frozen=True)
class Trials:
    """The tuning `base`, which is varied, and the recording that it is tried on; goes to workers whole."""

    base: Prepared
    window: Window
    models: Models
    objective: str = FIGURES[0]

    def source(self, values: dict[str, float]) -> Source:
        """The configuration of a trial; raises UsageError where a key is not there."""
        known = self.base.configuration.model_dump(mode="json")
        changed = assigned(self.base.source.data, known, for_axes(values, list(self.base.configuration.axes)))
        return Source.of(changed, self.base.source.path)

    def run(self, number: int, values: dict[str, float]) -> Trial:
        """Trial `number` on the recording."""
        source = self.source(values)
        try:
            parameters = revise(self.base, validate(source), source).parameters
        except (ConfigError, np.linalg.LinAlgError, ValueError, FloatingPointError) as problem:
            return Trial(number, values, problem=str(problem).partition("\n")[0])
        rerun = Rerun(self.window, self.models)
        rows = rerun.rows(parameters)
        if rerun.tracked(rows) < len(rows):
            return Trial(number, values, stopped=True)
        um = rerun.figures(rows)
        cost_um = float(np.sqrt(np.mean(um[FIGURES.index(self.objective)] ** 2)))
        return Trial(number, values, cost_um, tuple(map(tuple, um.tolist())))


def run_trial(numbered: tuple[int, dict[str, float]], trials: Trials) -> Trial:
    """A trial by its number and values, for another process."""
    return trials.run(*numbered)


def for_axes(values: dict[str, float], axes: Sequence[str]) -> dict[str, float]:
    """Each ``axes.*.`` key as the keys of the axes."""
    spread: dict[str, float] = {}
    for key, value in values.items():
        of_axis = key.removeprefix("axes.*.")
        spread |= dict.fromkeys([key] if of_axis == key else [f"axes.{axis}.{of_axis}" for axis in axes], value)
    return spread


def require_numbers(base: Prepared, variations: Sequence[Variation]) -> None:
    """Raise UsageError for a key that is not there, is no number, or is no part of a tuning."""
    known: dict[str, Any] = base.configuration.model_dump(mode="json")
    values = leaves(known)
    for key in for_axes({each.key: 0.0 for each in variations}, list(base.configuration.axes)):
        (path, *more) = selected(values, known, [key])
        if key.partition(".")[0] not in ("axes", "reference"):
            raise UsageError(f"--vary {key}: only axes and reference are a tuning; the rest is another cell")
        if more or isinstance(values[path], bool) or not isinstance(values[path], int | float):
            shown = "a section" if more else f"{values[path]!s:.40}"
            raise UsageError(f"--vary {key}: it is {shown}; only numbers can be varied")
