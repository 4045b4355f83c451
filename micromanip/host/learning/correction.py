"""What the loop plays of the memories: rows in the shared samples, and a word of it in every set of parameters.

The rows are written while nothing is played, and nothing can be: no set of parameters that the loop may come to names a
memory then. They are announced by a set that does, which comes into force as any other. Whoever dies meanwhile leaves
a set in force that plays nothing. A path that repeats is played to without a stop: there the rows come into the half of
the samples that the loop does not play.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.learned import WIRED_SEARCH_S, Played, fill_learned
from micromanip.rt.laws.learned import PLAYS
from micromanip.settings.check import Prepared
from micromanip.settings.commissioned import tuning_hash
from micromanip.settings.schema.learning import Learning
from micromanip.settings.schema.model import Configuration

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Memories:
    """Rows (2 n, MAX_AXES) of a part; tuning and generation of each axis that has a memory, by its name.

    All are of one tool, 0 where none is told, each at the temperature of `temperatures_C` where somebody measures it.
    """

    rows: Array
    tunings: Mapping[str, str] = field(default_factory=dict)
    generations: Mapping[str, int] = field(default_factory=dict)
    tool: int = 0
    temperatures_C: Mapping[str, float] = field(default_factory=dict)

    def without(self, axes: Collection[str]) -> Memories:
        """The same, but for those of `axes`."""
        tunings = {name: tuning for name, tuning in self.tunings.items() if name not in axes}
        return replace(self, tunings=tunings, generations={name: self.generations[name] for name in tunings})

    def problem(self, configuration: Configuration) -> str | None:
        """Why they can't be played; None where they can."""
        learning = configuration.learning
        assert learning is not None
        wanted = 2 * round(learning.seconds * configuration.loop.rate_hz)
        if len(self.rows) != wanted:
            return f"a part has {len(self.rows) // 2} cycles in it, learning.seconds says {wanted // 2}"
        for i, name in enumerate(configuration.axes):
            if name not in self.generations:
                continue
            if not np.isfinite(self.rows[:, i]).all():
                return f"axis {name}: not all of it are numbers"
            peak_um = float(np.abs(self.rows[: wanted // 2, i]).max())
            if peak_um > learning.limit_um:
                return f"axis {name}: it goes to {peak_um:.3g} um, learning.limit_um is {learning.limit_um:g}"
        return None


class Correction:
    """Adds to sets of parameters what of the present memories they may play."""

    def __init__(self, prepared: Prepared, learning: Learning, table: Array) -> None:
        """`table` are the shared samples; nothing is played yet."""
        wired = "part" in prepared.configuration.signals
        search_s = 0.0 if wired else learning.search_s
        if learning.repeats:
            search_s = max(search_s, WIRED_SEARCH_S)
        self._played = Played(learning.limit_um, learning.tolerance_um, search_s, learning.repeats)
        self._table, self._last = table, 0
        self._places = 2 if learning.repeats else 1
        self.rows = len(table) // self._places
        """Of a memory; of a path that repeats the table has room for two, of which the loop plays one."""
        self._begun: dict[str, int] = {}
        self.number = 0
        """Of what may be played; 0: nothing."""
        self.stated_tool = 0
        """Which tool it is, where no signal says so."""
        self.temperature_C: float | None = None
        """Of the cell now; None where nobody knows."""
        self._within_K = learning.temperature_K
        self.dropped: set[str] = set()
        """Axes whose memories are not to be played, whatever they are."""
        self.memories = Memories(np.zeros_like(table[: self.rows]))

    def withdraw(self) -> None:
        """Nothing may be played, by the next set of parameters."""
        self.number = 0

    def hold(self, memories: Memories) -> None:
        """Play these from the next set of parameters on.

        Only while the loop reads none: it plays nothing, and the set in force has no number. Where the path repeats:
        while `may_hold`.
        """
        self.memories = memories
        if not self._played.repeats:
            self._begun = {}
        self._last += 1
        self._table[self._first : self._first + self.rows] = memories.rows
        self.number = self._last

    @property
    def _first(self) -> int:
        """Where the rows of the last memory are."""
        return self._last % self._places * self.rows

    def may_hold(self, numbers: Any, states: Any) -> bool:
        """Whether the loop plays nothing but the last memory, and can come to nothing else.

        `numbers` are those of the set in force, `states` (of LEARNED_STATE) those of the axes.
        """
        silent = (states["level"] == 0.0) & (states["why"] != PLAYS)
        passed = (states["number"] == self._last) & (states["changed"] == 1.0)
        return bool(np.isin(numbers, (0, self._last)).all() and (silent | passed).all())

    def forget(self, axis: str) -> None:
        """There is none of `axis` any more; what comes next is new."""
        self.memories = self.memories.without([axis])
        self.dropped.discard(axis)

    def recognised(self, axis: str, cycle: int) -> None:
        """The part that is made began in `cycle`, by the path of `axis`."""
        self._begun[axis] = cycle

    def may_play(self, configuration: Configuration, axis: str) -> bool:
        """Whether there is a memory of `axis`, of the tuning that it has in `configuration`."""
        own = self.memories.tunings.get(axis)
        warm_C, now_C = self.memories.temperatures_C.get(axis), self.temperature_C
        near = warm_C is None or (now_C is not None and abs(now_C - warm_C) <= self._within_K)
        if self.number == 0 or own is None or axis in self.dropped or not near:
            return False
        return own == tuning_hash(configuration.axes[axis])

    def added(self, prepared: Prepared, parameters: Any, *, candidate: bool = False) -> Any:
        """`parameters` of `prepared`, with what they may play; a candidate plays nothing."""
        parameters = parameters.copy()
        parameters[0]["stated_tool"], parameters[0]["learned_tool"] = self.stated_tool, self.memories.tool
        loop_hz = float(prepared.configuration.loop.rate_hz)
        for i, name in enumerate(prepared.configuration.axes):
            p = parameters[0]["axis"][i]["learned"]
            plays = not candidate and self.may_play(prepared.configuration, name)
            fill_learned(p, self.number if plays else 0, i, self.rows, self._played, loop_hz, self._first)
            p["begun_cycle"] = self._begun.get(name, -1)
        return parameters


def is_silent(states: Any) -> bool:
    """Whether no axis of `states` (of LEARNED_STATE) plays anything, or is just ending."""
    return bool((states["level"] == 0.0).all() and (states["why"] != PLAYS).all())
