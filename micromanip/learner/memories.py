"""The memories of a running cell: read at the start, updated after each part, made into rows for the loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.control.learned import RECOGNISED_S, rows_to_play
from micromanip.design.learning.law import Update, updated
from micromanip.design.learning.learner import begun, way_of
from micromanip.design.learning.memory import Memory, memory_file, read_memory, remove_memory, write_memory
from micromanip.design.learning.part import Part, Run
from micromanip.design.learning.recognised import found_at
from micromanip.design.learning.usable import require_usable
from micromanip.errors import CheckFailed, MicromanipError, system_error
from micromanip.rt.telemetry import LEARNED_PLAYS
from micromanip.settings.schema.learning import Learning
from micromanip.settings.schema.model import Configuration

from .gathering import MadePart

_WIRED_SEARCH_S = 0.05
"""The signal says to the cycle when a part begins; machines do not."""


class Memories:
    """Those of the axes of one configuration."""

    def __init__(self, configuration: Configuration, learning: Learning, folder: Path) -> None:
        """Nothing is read yet. CheckFailed where an axis has not what learning needs."""
        self._configuration, self._learning, self._folder = configuration, learning, folder
        wired = "part" in configuration.signals
        self.search_s = 0.0 if wired else learning.search_s
        self._found_within_s = _WIRED_SEARCH_S if wired else learning.search_s
        self._ways = {name: way_of(configuration, name) for name in configuration.axes}
        self._known: dict[str, Memory] = {}
        self._barred: set[str] = set()

    def read(self) -> Iterator[str]:
        """Take over what is in the folder; a sentence for each memory that can't be used: its axis does not learn."""
        for name, way in self._ways.items():
            assert way.highest_Hz >= 0.0  # worked out now: it takes a second, and a part waits for nobody
            file = memory_file(self._folder, name)
            try:
                memory = read_memory(file)
                if memory is not None:
                    require_usable(memory, self._configuration, name, file)
                    self._known[name] = memory
            except MicromanipError as problem:
                self._barred.add(name)
                yield f"{problem}; nothing is learned or played of axis {name}"

    def forget(self, axes: list[str]) -> None:
        """Remove the memories of `axes`, damaged ones too. Raises MicromanipError where a file can't be."""
        for name in axes:
            file = memory_file(self._folder, name)
            if file.exists():
                remove_memory(file)
            self._known.pop(name, None)
            self._barred.discard(name)

    def learn(self, part: MadePart, breathe: Callable[[], None]) -> Iterator[tuple[str, Update | CheckFailed]]:
        """What each axis makes of a whole part; its memory is in its file then. `breathe` is called in between."""
        for name in self._ways:
            if name not in self._barred:
                breathe()
                try:
                    update = self._updated(name, part)
                    write_memory(memory_file(self._folder, name), update.memory)
                except CheckFailed as refusal:
                    yield name, refusal
                except OSError as problem:
                    yield name, CheckFailed(str(system_error(problem, self._folder)))
                else:
                    self._known[name] = update.memory
                    yield name, update

    def recognised(self, part: MadePart) -> dict[str, int]:
        """The cycle in which the part began, by the path of each axis that knows its own again."""
        found = {}
        for name, memory in self._known.items():
            seen = replace(memory, path_um=memory.path_um[: round(RECOGNISED_S * memory.rate_hz)])
            run = self._run(name, part)
            try:
                at_s = found_at(seen, run, self._about_s(part), self.search_s, self._learning.tolerance_um)
            except CheckFailed:
                continue
            found[name] = part.first + round(at_s * self._configuration.loop.rate_hz)
        return found

    def rows(self) -> Any:
        """What is to be played, with its paths, as the loop reads it: (2 n, MAX_AXES)."""
        loop_hz = float(self._configuration.loop.rate_hz)
        axes = list(self._configuration.axes)
        rate_hz = next((memory.rate_hz for memory in self._known.values()), loop_hz)
        return rows_to_play(
            {axes.index(name): (each.now.correction_um, each.path_um) for name, each in self._known.items()},
            rate_hz, loop_hz,
        )  # fmt: skip

    @property
    def known(self) -> dict[str, Memory]:
        """Memory of each axis that has one."""
        return self._known

    def _about_s(self, part: MadePart) -> float:
        return (part.begun - part.first) / self._configuration.loop.rate_hz

    def _updated(self, name: str, part: MadePart) -> Update:
        way, memory, about_s = self._ways[name], self._known.get(name), self._about_s(part)
        tracker, run, seconds = way.laws.tracker, self._run(name, part), self._learning.seconds
        at_s = about_s
        if memory is not None:
            at_s = found_at(memory, run, about_s, self._found_within_s, self._learning.tolerance_um)
        made: Part = run.part(tracker, at_s, seconds)
        if memory is None:
            memory = begun(self._configuration, name, made, at_s)
        from_s = self._played_from_s(name, part, at_s)
        return updated(memory, made, way, self._learning.limit_um, run.what, from_s, own=True)

    def _played_from_s(self, name: str, part: MadePart, at_s: float) -> float:
        """When in the part the correction was first played; 0 where it was not."""
        axis = list(self._configuration.axes).index(name)
        played = np.flatnonzero(part.rows["axis"]["fresh"][:, axis] & LEARNED_PLAYS)
        if not len(played):
            return 0.0
        cycles = int(part.rows["cycle"][played[0]]) - part.first
        return max(0.0, cycles / self._configuration.loop.rate_hz - at_s)

    def _run(self, name: str, part: MadePart) -> Run:
        axis = part.rows["axis"][:, list(self._configuration.axes).index(name)]

        def cell(column: str) -> Any:
            # the host hands over memories in between: only another tuning is another run, and ends the part
            return np.zeros(len(part.rows), int) if column == "version" else part.rows[column]

        range_V = self._configuration.outputs[f"voltage_{name}"].range_V
        period_s = self._configuration.loop.period_ns * 1e-9
        return Run.of(f"part {part.number}", cell, axis.__getitem__, period_s, range_V)
