"""Identical parts in virtual time: a simulated cell that learns from one to the next, and what is left in the end.

Each part is the same path from the same start with other noise. What repeats of the true path error is its mean over
parts with one correction, less what chance leaves in a mean of so many; the rest is the floor: noise and process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from micromanip.control.learned import fill_learned, rows_to_play
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment
from micromanip.virtual.switched import simulated_driver

from .law import BLOCKS, Update, updated
from .learner import begun, way_of
from .memory import Memory
from .part import Run

Array = NDArray[np.float64]
Rows = NDArray[Any]

_AFTER_FORCE_S = 1.0
_SURE = 0.95


@dataclass(frozen=True)
class Left:
    """True path error of an axis, um rms, over some parts: whole, what repeats (at most, 95 %), and what does not."""

    whole_um: float
    repeats_um: float
    most_um: float
    floor_um: float

    @classmethod
    def of(cls, errors_um: Array) -> Left:
        """Of errors (parts, n)."""
        count = len(errors_um)
        repeats = errors_um.mean(axis=0) ** 2 - errors_um.var(axis=0, ddof=1) / count
        blocks = np.array([block.mean() for block in np.array_split(repeats, BLOCKS)])
        mean = float(repeats.mean())
        most = mean + float(student.ppf(_SURE, BLOCKS - 1)) * float(blocks.std(ddof=1)) / np.sqrt(BLOCKS)
        return cls(
            float(np.sqrt(np.mean(errors_um**2))), float(np.sqrt(max(0.0, mean))), float(np.sqrt(max(0.0, most))),
            float(np.sqrt(errors_um.var(axis=0, ddof=1).mean())),
        )  # fmt: skip


class Cell:
    """The simulated cell of `prepared`, which makes the same part of `seconds` again and again."""

    def __init__(self, prepared: Prepared, seconds: float, limit_um: float) -> None:
        """CheckFailed where an axis has not what learning needs, UsageError where it is not simulated."""
        self._prepared, self._seconds, self._limit_um = prepared, seconds, limit_um
        self._driver = simulated_driver(prepared)
        self.ways = {name: way_of(prepared.configuration, name) for name in prepared.configuration.axes}
        self.memories: dict[str, Memory] = {}
        self._number = 0

    def make(self, seed: int, corrections: Mapping[str, Array] | None = None) -> tuple[Rows, float]:
        """Rows of a part with noise of `seed` and when in them it begins, s after tracking has.

        Played are `corrections`, those of the memories where none are given. CheckFailed where the cell fails.
        """
        prepared, configuration = self._prepared, self._prepared.configuration
        if corrections is None:
            corrections = {name: memory.now.correction_um for name, memory in self.memories.items()}
        options: Any = prepared.wiring.options[self._driver].model_copy(update={"seed": seed})
        driver = type(prepared.wiring.drivers[self._driver])(options, configuration.loop.period_ns)
        wiring = replace(prepared.wiring, drivers={**prepared.wiring.drivers, self._driver: driver})
        experiment = VirtualExperiment(replace(prepared, wiring=wiring), process=True)
        axes, loop_hz = list(configuration.axes), float(configuration.loop.rate_hz)
        rate_hz = next((memory.rate_hz for memory in self.memories.values()), loop_hz)
        played = rows_to_play({axes.index(name): c for name, c in corrections.items()}, rate_hz, loop_hz)
        cell = experiment.cell(configuration, played)
        passed_s = len(cell.arm()) / loop_hz
        begin_s = max(_AFTER_FORCE_S, options.force.start_s + _AFTER_FORCE_S - passed_s)
        before = cell.run(begin_s)
        for i, name in enumerate(axes):
            if name in corrections:
                fill_learned(cell.parameters[0]["axis"][i]["learned"], 1, i, len(played), self._limit_um, loop_hz)
        rows = np.concatenate([before, cell.run(self._seconds + _AFTER_FORCE_S)])
        experiment.require_no_fault(cell)
        return rows, begin_s

    def learn(self, rows: Rows, begin_s: float, what: str) -> dict[str, Update]:
        """Let each axis learn from a part that `make` has made."""
        found = {}
        for name in self.ways:
            part = self._run(rows, name, what).part(self.ways[name].laws.tracker, begin_s, self._seconds)
            memory = self.memories.get(name) or begun(self._prepared.configuration, name, part, begin_s)
            found[name] = updated(memory, part, self.ways[name], self._limit_um, what)
            self.memories[name] = found[name].memory
        return found

    def true_error(self, rows: Rows, begin_s: float, column: str = "path_error_um") -> dict[str, Array]:
        """True path error (n,) of each axis during the part, um, or another column of the rows."""
        loop_hz = float(self._prepared.configuration.loop.rate_hz)
        first, count = round(begin_s * loop_hz), round(self._seconds * loop_hz)
        errors = rows["axis"][column][first:][:count]
        return {name: np.asarray(errors[:, i], dtype=float) for i, name in enumerate(self.ways)}

    def left(self, seeds: range, corrections: Mapping[str, Array], say: Callable[[int], None]) -> dict[str, Left]:
        """What is left over parts of `seeds` with the same `corrections`."""
        errors = []
        for place, seed in enumerate(seeds):
            say(place)
            errors.append(self.true_error(*self.make(seed, corrections)))
        return {name: Left.of(np.array([each[name] for each in errors])) for name in self.ways}

    def _run(self, rows: Rows, name: str, what: str) -> Run:
        configuration = self._prepared.configuration
        axis = rows["axis"][:, list(configuration.axes).index(name)]
        range_V = configuration.outputs[f"voltage_{name}"].range_V
        return Run.of(what, rows.__getitem__, axis.__getitem__, configuration.loop.period_ns * 1e-9, range_V)
