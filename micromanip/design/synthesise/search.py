"""The search for the best pair of regulator and filter: by halves on a grid, then downhill between its points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from micromanip.control.margins import margins
from micromanip.control.outer_gains import OuterGains
from micromanip.settings.schema.axis import Outer

from ..analyse.loops import Margins
from ..validate.step import StepAnswer
from .pairs import Candidate, Task, highest_Hz

_INPUTS_UM, _AT_ONCE_UM = (1e-4, 1e-3, 1e-2, 1e-1), (1.0,)
"""Noise of the set-point; the last only where the closed loop is measured as far up as such a filter asks for much."""
_MOST_INPUT_UM = 1.001 * _AT_ONCE_UM[-1]
_FINER, _WORTH = (10.0**0.25, 10.0**0.125), 0.995
"""Steps between those of the grid, and what is left of the cost where one is worth its while."""
_WAYS = tuple(
    tuple(sign * way for way in ways)
    for ways in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1))
    for sign in (1, -1)
)
"""In which weight, walk and noise of the set-point go up or down at once."""
_WIDER, _WIDEST, _FOR_WIDTH = 10.0**0.25, 1.0, 1.03
"""The oscillator's noise grows by this, at most to this share of the walk's, as long as the cost does not by more."""


class Search:
    """The best pair of those looked at so far, and what stood in the way of better ones."""

    def __init__(self, task: Task, bandwidth_Hz: float | None) -> None:
        self._task, self._bandwidth_Hz = task, bandwidth_Hz
        self.best: tuple[float, Candidate, Margins, StepAnswer] | None = None
        self.tried: list[tuple[float, float, float, float]] = []
        self.obstacles: list[str] = []

    def merit(self, candidate: Candidate) -> float:
        """Less is better."""
        if self._bandwidth_Hz is None:
            return candidate.cost
        return abs(float(np.log(max(candidate.bandwidth_Hz, 1e-3) / self._bandwidth_Hz)))

    def look(self, regulators: list[tuple[Outer, OuterGains, StepAnswer]]) -> None:
        """Each regulator's filters, by halves: where one is too fast, so are those beyond it."""
        for outer, gains, step in regulators:
            for input_um in _INPUTS_UM + (_AT_ONCE_UM if self._task.at_once else ()):
                chain = list(self._task.chain(outer, gains, input_um))
                while chain:
                    least = np.inf if self.best is None else self.best[0]
                    chain = [each for each in chain if self.merit(each) < least]
                    if not chain:
                        break
                    k = len(chain) // 2
                    if not self._taken(chain[k], step, np.inf):
                        chain = chain[:k]

    def descend(self, regulators: list[tuple[Outer, OuterGains, StepAnswer]]) -> None:
        """Each regulator's filters from the slowest on, as long as they hold everything.

        By halves a regulator is given up whose middle filter, and slower ones, don't: what is proven may lie between.
        """
        for outer, gains, step in regulators:
            for input_um in _INPUTS_UM:
                held = False
                for pair in self._task.chain(outer, gains, input_um):
                    least = np.inf if self.best is None else self.best[0]
                    if self.merit(pair) >= least:
                        continue
                    if self._taken(pair, step, np.inf):
                        held = True
                    elif held:
                        break

    def refine(self, excess: Callable[[StepAnswer], float]) -> None:
        """Walk downhill from the best pair of the grid, in steps between its own; then widen the oscillator.

        Behind a bus it stays at the grid.
        """
        if not self._task.at_once:
            return
        for size in _FINER:
            before = None
            while self.best is not before:
                before = self.best
                for ways in _WAYS:
                    self._move(excess, *(size**way for way in ways))
        cheapest = np.inf if self.best is None else self.best[0]
        while self._wider(cheapest):
            pass

    def _move(self, excess: Callable[[StepAnswer], float], weight: float, walk: float, input_um: float) -> None:
        """Take the best pair with these factors on its figures, where that is better."""
        if self.best is None:
            return
        least, start, _, step = self.best
        outer, gains, filtering = start.outer, start.gains, start.filtering.times(walk, input_um)
        if filtering.input_um > _MOST_INPUT_UM:
            return
        if weight != 1.0:
            outer, gains, step = self._task.regulator(outer.control_weight * weight)
            if excess(step) > 1.0:
                return
        self._taken(self._task.pair(outer, gains, filtering), step, _WORTH * least)

    def _wider(self, cheapest: float) -> bool:
        """Whether the best pair bears a faster oscillator, which learns a tooth sooner and another speed as well."""
        if self.best is None or self._task.oscillation_Hz is None:
            return False
        _, start, _, step = self.best
        share = start.filtering.oscillation_um * _WIDER / start.filtering.disturbance_um
        if share > _WIDEST:
            return False
        filtering = replace(start.filtering, oscillation_um=share * start.filtering.disturbance_um)
        return self._taken(self._task.pair(start.outer, start.gains, filtering), step, _FOR_WIDTH * cheapest)

    def _taken(self, pair: Candidate | None, step: StepAnswer, most: float) -> bool:
        """Whether `pair` costs less than `most` and holds everything; it is the best then."""
        if pair is None or self.merit(pair) >= most:
            return False
        found = margins(pair.loop)
        crossover = highest_Hz(found.crossovers_Hz, self._task.oscillation_Hz)
        self.tried.append((pair.outer.control_weight, crossover, found.gain_dB, found.phase_deg))
        obstacle = self._task.obstacle(pair, found)
        if obstacle is None:
            self.best = self.merit(pair), pair, found, step
        else:
            self.obstacles.append(obstacle)
        return obstacle is None
