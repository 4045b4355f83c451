"""Memories on their way into the loop: rows in the shared samples, and a word of them in every set of parameters.

The rows are written while nothing is played, and nothing can be: no set of parameters that the loop may come to names a
memory then. They are announced by a set that does, which comes into force as any other. Whoever dies meanwhile leaves
a set in force that plays nothing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.laws.learned import PLAYS
from micromanip.rt.states import TRACKING
from micromanip.settings.check import Prepared
from micromanip.settings.schema.learning import Learning
from micromanip.settings.schema.model import Configuration
from micromanip.settings.tuning_hash import tuning_hash

from ..controller import Controller

Array = NDArray[np.float64]
Put = Callable[[Callable[[], None]], Awaitable[None]]

FADE_S = 0.05
"""Soft for the stage's first mode, and short beside a part, which is not corrected in full meanwhile."""


@dataclass(frozen=True)
class Memories:
    """Rows (2 n, MAX_AXES) of a part; tuning and generation of each axis that has a memory, by its name.

    All are of one tool, 0 where none is named, each at the temperature of `temperatures_C` where somebody measures it.
    """

    rows: Array
    tunings: Mapping[str, str] = field(default_factory=dict)
    generations: Mapping[str, int] = field(default_factory=dict)
    tool: int = 0
    temperatures_C: Mapping[str, float] = field(default_factory=dict)

    def without(self, axes: Collection[str]) -> Memories:
        """The same, but for those of `axes`."""
        generations = {name: number for name, number in self.generations.items() if name not in axes}
        return replace(self, generations=generations)

    def problem(self, learning: Learning, axes: Collection[str]) -> str | None:
        """Why they can't be played; None where they can."""
        for i, name in enumerate(axes):
            if name not in self.generations:
                continue
            if not np.isfinite(self.rows[:, i]).all():
                return f"axis {name}: not all of it are numbers"
            peak_um = float(np.abs(self.rows[: len(self.rows) // 2, i]).max())
            if peak_um > learning.limit_um:
                return f"axis {name}: it goes to {peak_um:.3g} um, learning.limit_um is {learning.limit_um:g}"
        return None


class Handover:
    """Adds to sets of parameters what of the present memories they may play, and brings new ones into the loop."""

    def __init__(self, learning: Learning, table: Array) -> None:
        """`table` are the shared samples; nothing is played yet."""
        self._learning, self._table, self._last = learning, table, 0
        self._number = 0
        """Of what may be played; 0: nothing."""
        self.temperature_C: float | None = None
        """Of the cell now; None where nobody knows."""
        self.forgotten: set[str] = set()
        """Axes whose memories are not to be played, whatever they are: they are being forgotten."""
        self.memories = Memories(np.zeros_like(table))
        self.next: Memories | None = None
        """What was learned last, and is not played yet."""

    def forget(self, axis: str) -> None:
        """There is no memory of `axis` any more; what comes next is new."""
        self.memories = self.memories.without([axis])
        self.next = None if self.next is None else self.next.without([axis])
        self.forgotten.discard(axis)

    def may_play(self, configuration: Configuration, axis: str) -> bool:
        """Whether there is a memory of `axis`, of the tuning that it has in `configuration` and this temperature."""
        if self._number == 0 or axis not in self.memories.generations or axis in self.forgotten:
            return False
        warm_C, now_C = self.memories.temperatures_C.get(axis), self.temperature_C
        if warm_C is not None and (now_C is None or abs(now_C - warm_C) > self._learning.temperature_K):
            return False
        return self.memories.tunings[axis] == tuning_hash(configuration.axes[axis])

    def added(self, prepared: Prepared, parameters: Any, *, candidate: bool = False) -> Any:
        """`parameters` of `prepared`, with what they may play; a candidate plays nothing."""
        parameters = parameters.copy()
        parameters[0]["learned_tool"] = self.memories.tool
        loop_hz = float(prepared.configuration.loop.rate_hz)
        for i, name in enumerate(prepared.configuration.axes):
            plays = not candidate and self.may_play(prepared.configuration, name)
            fill_learned(
                parameters[0]["axis"][i]["learned"], self._number if plays else 0, i, len(self._table), self._learning,
                loop_hz,
            )  # fmt: skip
        return parameters

    async def look(self, controller: Controller, put: Put) -> None:
        """Put new memories in force while no part is made; after another tuning came into force, the present again."""
        cell, in_force = controller.status["state"][0], controller.buffers.in_force
        configuration = controller.prepared.configuration
        if in_force is None or self._is_made(cell):
            return
        names = list(configuration.axes)
        learned, playing = cell["axis"]["learned"][: len(names)], in_force["axis"]["learned"]["number"][: len(names)]
        with contextlib.suppress(CheckFailed):  # somebody else changes something: the next time
            if self.next is None:
                if list(playing) != [self._number if self.may_play(configuration, name) else 0 for name in names]:
                    await put(lambda: None)
            elif playing.any() or controller.buffers.is_unconfirmed:
                await put(self._withdraw)
            elif (learned["level"] == 0.0).all() and (learned["why"] != PLAYS).all():
                await put(self._hold_next)

    def _is_made(self, cell: Any) -> bool:
        """Whether a part is being made; one that nobody ends is over once it has had its time."""
        over = len(self._table) // 2
        return bool(cell["state"] == TRACKING and cell["part"] != 0 and cell["cycle"] - cell["part_begun"] < over)

    def _withdraw(self) -> None:
        self._number = 0

    def _hold_next(self) -> None:
        """Only while the loop reads no rows: it plays nothing, and the set in force has no number."""
        assert self.next is not None
        self.memories, self.next = self.next, None
        self._table[:] = self.memories.rows
        self._last += 1
        self._number = self._last


def fill_learned(p: Any, number: int, axis: int, rows: int, learning: Learning, loop_hz: float) -> None:
    """Let the axis' record `p` (of LEARNED_PARAMETERS) play half of `rows` rows; `number` 0: none any more."""
    p["number"], p["rows"], p["column"] = number, rows // 2, axis
    p["fade_cycles"] = max(1, round(FADE_S * loop_hz))
    p["limit_um"], p["tolerance_um"], p["cycles_per_s"] = learning.limit_um, learning.tolerance_um, loop_hz
