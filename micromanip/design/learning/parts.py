"""Identical parts of a simulated cell in virtual time: the same path from the same start, with other noise.

Without anything that is drawn (noise of the sensors, of the amplifier and of the force) only what repeats is left of
the path error: path, plant, steady force and tooth passing, which a simulation begins with the same phase each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.learned import Played, fill_learned, rows_to_play
from micromanip.rt.states import BEGIN_PART
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import DRAWN, simulated_driver, switched, trust, trusted

from .law import Update, updated
from .learner import begun, way_of
from .memory import Memory
from .part import Run

Array = NDArray[np.float64]
Rows = NDArray[Any]

_AFTER_FORCE_S = 1.0


class Cell:
    """The simulated cell of `prepared`, which makes the same part of `seconds` again and again."""

    def __init__(self, prepared: Prepared, seconds: float, limit_um: float) -> None:
        """CheckFailed where an axis has not what learning needs, UsageError where it is not simulated."""
        self._prepared, self._seconds, self._limit_um = prepared, seconds, limit_um
        self._driver = simulated_driver(prepared)
        self.ways = {name: way_of(prepared.configuration, name) for name in prepared.configuration.axes}
        self.memories: dict[str, Memory] = {}
        self._trust: Array | None = None

    def make(self, seed: int | None, corrections: Mapping[str, Array]) -> tuple[Rows, float]:
        """Rows of a part in which `corrections` are played, and when in them it begins, s after tracking has.

        `seed` draws the noise; None: there is none. CheckFailed where the cell fails.
        """
        prepared, configuration = self._prepared, self._prepared.configuration
        options: Any = prepared.wiring.options[self._driver]
        options = switched(options, DRAWN) if seed is None else options.model_copy(update={"seed": seed})
        experiment = VirtualExperiment(with_options(prepared, self._driver, options), process=True)
        axes, loop_hz = list(configuration.axes), float(configuration.loop.rate_hz)
        rate_hz = next((memory.rate_hz for memory in self.memories.values()), loop_hz)
        played = rows_to_play(
            {axes.index(name): (each, self.memories[name].path_um) for name, each in corrections.items()},
            rate_hz, loop_hz,
        )  # fmt: skip
        cell = experiment.cell(configuration, played)
        passed_s = len(cell.arm()) / loop_hz
        if seed is None and self._trust is not None:
            trust(cell, self._trust)
        begin_s = max(_AFTER_FORCE_S, options.force.start_s + _AFTER_FORCE_S - passed_s)
        before = cell.run(begin_s)
        for i, name in enumerate(axes):
            if name in corrections:
                p = cell.parameters[0]["axis"][i]["learned"]
                fill_learned(p, 1, i, len(played), Played(self._limit_um), loop_hz)
        rows = np.concatenate([before, cell.run(self._seconds + _AFTER_FORCE_S, command=BEGIN_PART)])
        experiment.require_no_fault(cell)
        if seed is not None:
            self._trust = trusted(cell)
        return rows, begin_s

    @property
    def corrections(self) -> dict[str, Array]:
        """What the memories would play."""
        return {name: memory.now.correction_um for name, memory in self.memories.items()}

    def learn(self, rows: Rows, begin_s: float, what: str) -> dict[str, Update]:
        """Let each axis learn from a part that `make` has made."""
        found = {}
        for name in self.ways:
            part = self.run_of(rows, name, what).part(begin_s, self._seconds)
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

    def run_of(self, rows: Rows, name: str, what: str) -> Run:
        """Axis `name` in `rows` that `make` has made."""
        configuration = self._prepared.configuration
        axis = rows["axis"][:, list(configuration.axes).index(name)]
        range_V = configuration.outputs[f"voltage_{name}"].range_V
        return Run.of(what, rows.__getitem__, axis.__getitem__, configuration.loop.period_ns * 1e-9, range_V)
