"""The memories of a running cell: read at the start, updated after each part, made into rows for the loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.control.learned import FADE_S, RECOGNISED_S, WIRED_SEARCH_S, rows_to_play
from micromanip.design.learning.law import Update, updated
from micromanip.design.learning.learner import begun, way_of
from micromanip.design.learning.memory import Memory, memory_files, put_aside, read_memory, remove_memory, write_memory
from micromanip.design.learning.part import Part, Run
from micromanip.design.learning.recognised import found_at
from micromanip.design.learning.usable import require_usable
from micromanip.errors import CheckFailed, MicromanipError, system_error
from micromanip.rt.telemetry import LEARNED_PLAYS
from micromanip.settings.schema.learning import Learning
from micromanip.settings.schema.model import Configuration

from .gathering import MadePart
from .shelf import UNKNOWN, Conditions, Shelf


class Memories:
    """Those of the axes of one configuration."""

    def __init__(self, configuration: Configuration, learning: Learning, folder: Path) -> None:
        """Nothing is read yet. CheckFailed where an axis has not what learning needs."""
        self._configuration, self._learning, self._folder = configuration, learning, folder
        wired = "part" in configuration.signals
        self.search_s = 0.0 if wired else learning.search_s
        self._found_within_s = WIRED_SEARCH_S if wired else learning.search_s
        self.begun: dict[str, int] = {}
        """By the axis: the cycle in which the part began that it learned from last, by its path."""
        self._ways = {name: way_of(configuration, name) for name in configuration.axes}
        self._shelves = {name: Shelf(folder, name, learning.temperature_K) for name in self._ways}
        self._has_tool, self._is_measured = (name in configuration.signals for name in ("tool", "temperature"))
        self.now = self.conditions(0, None)
        """Tool and temperature that what is played has to fit."""
        self._gone_by = self.now
        self._barred: set[str] = set()

    def read(self) -> Iterator[str]:
        """Take over what is in the folder; a sentence for each memory that can't be used: its axis does not learn."""
        for name, way in self._ways.items():
            assert way.highest_Hz >= 0.0  # worked out now: it takes a second, and a part waits for nobody
            for file in memory_files(self._folder, name):
                try:
                    memory = read_memory(file)
                    if memory is not None:
                        require_usable(memory, self._configuration, name, file)
                        self._shelves[name].put(file, memory)
                except MicromanipError as problem:
                    self._barred.add(name)
                    yield f"{problem}; nothing is learned or played of axis {name}"

    def forget(self, axes: list[str]) -> None:
        """Remove the memories of `axes`, damaged ones too. Raises MicromanipError where a file can't be."""
        for name in axes:
            for file in memory_files(self._folder, name):
                remove_memory(file)
            self._shelves[name].clear()
            self._barred.discard(name)

    def put_aside(self, axes: list[str]) -> tuple[list[str], dict[str, str]]:
        """Play nothing more of `axes`, and begin anew: the files stay, under the names that are returned.

        An axis of which one can't be put aside neither learns nor plays; why, by its name.
        """
        kept: list[str] = []
        problems: dict[str, str] = {}
        for name in axes:
            self._shelves[name].clear()
            self._barred.discard(name)
            for file in memory_files(self._folder, name):
                try:
                    kept.append(put_aside(file).name)
                except MicromanipError as problem:
                    self._barred.add(name)
                    problems[name] = str(problem)
        return kept, problems

    @property
    def tool(self) -> int:
        """Which tool `rows` are of, 0 where none is told."""
        return max(0, self.now.tool)

    def conditions(self, tool: int, temperature_C: float | None) -> Conditions:
        """What the rows say of the tool, and the host of the temperature, as memories know it."""
        return Conditions(
            UNKNOWN if self._has_tool and tool == 0 else tool,
            temperature_C,
            self._is_measured and temperature_C is None,
        )

    def move_to(self, now: Conditions) -> str | None:
        """Go by the memories that fit `now`; a sentence where others are played then, or none instead of some."""
        before, last, self.now = self._files(), self.now, now
        after = self._files()
        # a temperature that creeps was that of the last sentence, a tool may have been another one since
        old = self._gone_by if self._gone_by.tool == last.tool else last
        if after == before:
            return None
        self._gone_by = now
        told = []
        for names, what in (
            ([name for name in after if after[name] != before.get(name)], "goes by what was learned then"),
            ([name for name in before if name not in after], "has no memory of that: plays nothing, learns anew"),
        ):
            if names and not (now.unknown and what.startswith("has")):
                told.append(f"axis {', '.join(names)} {what}")
        if now.unknown:
            told.append("nothing is played or learned")
        return f"{now} instead of {old}: {'; '.join(told)}; the other memories are kept"

    def _files(self) -> dict[str, Path]:
        """Of the memory that is played, by its axis."""
        found = {name: shelf.fitting(self.now) for name, shelf in self._shelves.items() if name not in self._barred}
        return {name: file for name, (file, memory) in found.items() if memory is not None}

    def learn(
        self, part: MadePart, breathe: Callable[[], None], temperature_C: float | None = None
    ) -> Iterator[tuple[str, Update | CheckFailed]]:
        """What each axis makes of a whole part; its memory is in its file then. `breathe` is called in between."""
        made_with = self.conditions(part.tool, temperature_C)
        for name in self._ways:
            if name not in self._barred:
                breathe()
                try:
                    update, file = self._updated(name, part, made_with)
                    write_memory(file, update.memory)
                except CheckFailed as refusal:
                    yield name, refusal
                except OSError as problem:
                    yield name, CheckFailed(str(system_error(problem, self._folder)))
                else:
                    self._shelves[name].put(file, update.memory)
                    yield name, update

    def recognised(self, part: MadePart) -> dict[str, int]:
        """The cycle in which the part began, by the path of each axis that knows its own again."""
        found = {}
        for name, memory in self.known.items():
            seen = replace(memory, path_um=memory.path_um[: round(RECOGNISED_S * memory.rate_hz)])
            run = self._run(name, part)
            try:
                at_s = found_at(seen, run, self._about_s(part), self._found_within_s, self._learning.tolerance_um)
            except CheckFailed:
                continue
            found[name] = self._cycle(part, at_s)
        return found

    def rows(self) -> Any:
        """What is to be played, with its paths, as the loop reads it: (2 n, MAX_AXES)."""
        loop_hz = float(self._configuration.loop.rate_hz)
        axes = list(self._configuration.axes)
        known = self.known
        rate_hz = next((memory.rate_hz for memory in known.values()), loop_hz)
        return rows_to_play(
            {axes.index(name): (each.now.correction_um, each.path_um) for name, each in known.items()},
            rate_hz, loop_hz, repeats=self._learning.repeats,
        )  # fmt: skip

    @property
    def known(self) -> dict[str, Memory]:
        """Memory of each axis that has one of the tool and the temperature that there are now."""
        found = {name: shelf.fitting(self.now)[1] for name, shelf in self._shelves.items() if name not in self._barred}
        return {name: memory for name, memory in found.items() if memory is not None}

    def _about_s(self, part: MadePart) -> float:
        return (part.begun - part.first) / self._configuration.loop.rate_hz

    def _cycle(self, part: MadePart, at_s: float) -> int:
        return part.first + round(at_s * self._configuration.loop.rate_hz)

    def _updated(self, name: str, part: MadePart, made_with: Conditions) -> tuple[Update, Path]:
        if made_with.unknown:
            raise CheckFailed(f"part {part.number}: {made_with.unknown}: nothing is learned from it")
        file, memory = self._shelves[name].fitting(made_with)
        way, about_s = self._ways[name], self._about_s(part)
        run, seconds = self._run(name, part), self._learning.seconds
        at_s = about_s
        if memory is not None:
            at_s = found_at(memory, run, about_s, self._found_within_s, self._learning.tolerance_um)
        made: Part = run.part(at_s, seconds)
        if memory is None:
            warm_C = made_with.temperature_C
            repeats = self._learning.repeats
            memory = begun(self._configuration, name, made, at_s, made_with.tool, warm_C, repeats=repeats)
        from_s = self._played_from_s(name, part, at_s)
        update = updated(memory, made, way, self._learning.limit_um, run.what, from_s, own=True)
        self.begun[name] = self._cycle(part, at_s)
        return replace(update, memory=_warmed(update.memory, made_with)), file

    def _played_from_s(self, name: str, part: MadePart, at_s: float) -> float:
        """When in the part the correction was first played; 0 where it was not."""
        axis = list(self._configuration.axes).index(name)
        played = np.flatnonzero(part.rows["axis"]["fresh"][:, axis] & LEARNED_PLAYS)
        if not len(played):
            return 0.0
        cycles = int(part.rows["cycle"][played[0]]) - part.first
        from_s = max(0.0, cycles / self._configuration.loop.rate_hz - at_s)
        # the rows go on beyond a period, and the next one may be the first that is played to
        return 0.0 if self._learning.repeats and from_s > 2.0 * FADE_S else from_s

    def _run(self, name: str, part: MadePart) -> Run:
        axis = part.rows["axis"][:, list(self._configuration.axes).index(name)]

        def cell(column: str) -> Any:
            # the host hands over memories in between: only another tuning is another run, and ends the part
            return np.zeros(len(part.rows), int) if column == "version" else part.rows[column]

        range_V = self._configuration.outputs[f"voltage_{name}"].range_V
        period_s = self._configuration.loop.period_ns * 1e-9
        return Run.of(f"part {part.number}", cell, axis.__getitem__, period_s, range_V)


def _warmed(memory: Memory, made_with: Conditions) -> Memory:
    """`memory`, which has just learned from a part that was made at another temperature: it has that of the mean."""
    now_C, before_C = made_with.temperature_C, memory.temperature_C
    if now_C is None or before_C is None:
        return memory
    return replace(memory, temperature_C=before_C + (now_C - before_C) / max(1, memory.now.parts))
