"""The memories of a running cell: read at the start, updated after each part, made into rows for the loop.

An axis has one memory for each tool, in a file of its own. A memory is of the temperature at which it was learned, too.
What does not fit now is kept, neither played nor learned from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from micromanip.design.learning.law import Update, updated, way_of
from micromanip.design.learning.memory import (
    Memory,
    memory_file,
    memory_files,
    put_aside,
    read_memory,
    remove_memory,
    write_memory,
)
from micromanip.design.learning.part import part_of
from micromanip.errors import CheckFailed, MicromanipError, system_error
from micromanip.rt.record import MAX_AXES
from micromanip.settings.schema.model import Configuration

from .part_collector import MadePart


class MemoryStore:
    """Those of the axes of one configuration."""

    def __init__(self, configuration: Configuration, folder: Path) -> None:
        """Nothing is read yet. CheckFailed where an axis has not what learning needs."""
        assert configuration.learning is not None
        self._configuration, self._learning, self._folder = configuration, configuration.learning, folder
        self._ways = {name: way_of(configuration, name) for name in configuration.axes}
        self._kept: dict[tuple[str, int], Memory] = {}
        self._barred: set[str] = set()

    def read(self) -> Iterator[str]:
        """Take over what is in the folder; a sentence for each memory that can't be used: its axis does not learn."""
        for name, way in self._ways.items():
            assert way.highest_Hz >= 0.0  # worked out now: it takes a second, and a part waits for nobody
            for file in memory_files(self._folder, name):
                try:
                    memory = read_memory(file)
                    memory.require(self._configuration, name, file)
                    self._kept[name, memory.tool] = memory
                except MicromanipError as problem:
                    self._barred.add(name)
                    yield f"{problem}; nothing is learned or played of axis {name}"

    def forget(self, name: str, *, keep: bool) -> list[str]:
        """Begin anew with the axis: remove its memories, damaged ones too, or `keep` them under the names returned.

        Where a file stays, the axis neither learns nor plays: MicromanipError.
        """
        self._kept = {key: memory for key, memory in self._kept.items() if key[0] != name}
        self._barred.add(name)
        aside = []
        for file in memory_files(self._folder, name):
            if keep:
                aside.append(put_aside(file).name)
            else:
                remove_memory(file)
        self._barred.discard(name)
        return aside

    def of_tool(self, tool: int) -> dict[str, Memory]:
        """The memory with `tool` of each axis that has one."""
        return {name: memory for (name, own), memory in self._kept.items() if own == tool and name not in self._barred}

    def learn(
        self, part: MadePart, breathe: Callable[[], None], temperature_C: float | None = None
    ) -> Iterator[tuple[str, Update | CheckFailed]]:
        """What each axis makes of a part; its memory is in its file then. `breathe` is called in between."""
        for name in self._ways:
            if name not in self._barred:
                breathe()
                try:
                    update = self._updated(name, part, temperature_C)
                    write_memory(memory_file(self._folder, name, part.tool), update.memory)
                except CheckFailed as refusal:
                    yield name, CheckFailed(f"part {part.number}: {refusal}; nothing is learned from it")
                except OSError as problem:
                    yield name, CheckFailed(str(system_error(problem, self._folder)))
                else:
                    self._kept[name, part.tool] = update.memory
                    yield name, update

    def rows(self, tool: int) -> Any:
        """Corrections with `tool`, and their paths, as the loop reads them: (2 n, MAX_AXES), um, a row per cycle."""
        loop_hz = float(self._configuration.loop.rate_hz)
        cycles = round(self._learning.seconds * loop_hz)
        rows = np.zeros((2 * cycles, MAX_AXES))
        known = self.of_tool(tool)
        for column, name in enumerate(self._configuration.axes):
            if name in known:
                memory = known[name]
                rows[:cycles, column] = _by_cycle(memory.correction_um, memory.rate_hz / loop_hz, cycles)
                rows[cycles:, column] = _by_cycle(memory.path_um, memory.rate_hz / loop_hz, cycles)
        return rows

    def _updated(self, name: str, part: MadePart, now_C: float | None) -> Update:
        configuration, learning = self._configuration, self._learning
        if "tool" in configuration.signals and part.tool == 0:
            raise CheckFailed("the signal tool names no tool")
        if "temperature" in configuration.signals and now_C is None:
            raise CheckFailed("the signal temperature has no usable value")
        axis = list(configuration.axes).index(name)
        period_s, range_V = configuration.loop.period_ns * 1e-9, configuration.outputs[f"voltage_{name}"].range_V
        made = part_of(part.rows, axis, part.begun, learning.seconds, period_s, range_V)
        memory = self._kept.get((name, part.tool))
        if memory is None:
            memory = Memory.begun(configuration, name, made.rate_hz, made.path_um, part.tool, now_C)
        own_C = memory.temperature_C
        if now_C is not None and own_C is not None and abs(now_C - own_C) > learning.temperature_K:
            raise CheckFailed(f"the cell has {now_C:.1f} degC, axis {name} was learned at {own_C:.1f}")
        apart_um = float(np.sqrt(np.mean((made.path_um - memory.path_um) ** 2)))
        if apart_um > learning.tolerance_um:
            raise CheckFailed(
                f"axis {name} follows another path than its memory's, {apart_um:.3g} um rms beside it, "
                f"{learning.tolerance_um:g} um may be"
            )
        update = updated(memory, made, self._ways[name], learning.limit_um)
        if now_C is not None and own_C is not None:  # the memory's is the mean over its parts
            own_C += (now_C - own_C) / max(1, update.memory.parts)
        return replace(update, memory=replace(update.memory, temperature_C=own_C))


def _by_cycle(values: Any, step: float, cycles: int) -> Any:
    """`values` (n,), one in 1 / `step` cycles, for each of `cycles`; the last goes on."""
    return CubicSpline(np.arange(len(values)), values)(np.minimum(np.arange(cycles) * step, len(values) - 1.0))
