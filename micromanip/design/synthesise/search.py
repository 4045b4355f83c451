"""The search for the best pair of regulator and filter: by halves on a grid, then downhill between its points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from micromanip.control.margins import Margins, Unsure, grid, margins, within
from micromanip.control.outer_gains import OuterGains, StationaryFilter, augment, outer_gains, stationary_filter
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import Array, Complex, System
from micromanip.settings.schema.axis import LinearModel, Outer

from ..analyse.saturation import Reach, Samples, comes_to_rest
from ..validate.step import StepAnswer, predicted_step

_RESERVE_DB, _RESERVE_DEG = 0.3, 2.0
"""What is asked for beyond the least margins: the next identification gives a slightly other model."""
_WALKS_UM = np.geomspace(3e-6, 1.0, 21)
_OSCILLATION, _LATE_OSCILLATION = 1e-2, 1e-1
"""Noise of the tooth-passing oscillator in terms of the walk's; where samples come late integral action costs more."""
_DISTURBANCE_UM = 0.03
"""Random walk of the set-point, rms a cycle, that is to be removed: the tool's force, wandering."""
_BESIDE = 0.1
ROBUST, HOPELESS, _STEP_S = 3.0, 4.0, 0.2
UNKNOWN = "the margin within what the measured response leaves open"
FRAGILE = "Ms over the plants drawn around the model"
SLEWED = "a large swing, which the set-point's slew limit keeps alive,"


@dataclass(frozen=True)
class Filter:
    """Random walk, noise of the oscillator and of the set-point, um a cycle, by which the filter is made."""

    disturbance_um: float
    oscillation_um: float
    input_um: float

    @property
    def figures(self) -> dict[str, float]:
        """As the section `outer` has them."""
        found = {
            "disturbance_um": self.disturbance_um,
            "oscillation_um": self.oscillation_um,
            "input_noise_um": self.input_um,
        }
        return {name: float(f"{um:.4g}") for name, um in found.items()}

    def times(self, walk: float, input_um: float) -> Filter:
        """With other noises; the oscillator's goes with the walk's."""
        return Filter(self.disturbance_um * walk, self.oscillation_um * walk, self.input_um * input_um)


@dataclass(frozen=True)
class Candidate:
    """A pair of regulator and filter, with its cost (um^2) and an estimate of its highest crossover."""

    outer: Outer
    gains: OuterGains
    filtering: Filter
    loop: System
    cost: float
    bandwidth_Hz: float


def highest_Hz(hertz: list[float] | tuple[float, ...], oscillation_Hz: float | None) -> float:
    """Highest crossover; the oscillator makes two of its own, which say nothing of the rest."""
    own = [f for f in hertz if oscillation_Hz is None or abs(f / oscillation_Hz - 1.0) > _BESIDE]
    return max(own or hertz, default=0.0)


@dataclass(frozen=True)
class Task:
    """What a pair is judged by, and what is asked for."""

    model: LinearModel
    period_s: float
    noise_um: float
    oscillation_Hz: float | None
    sample_cycles: int
    late_cycles: int
    unsure: Unsure
    bears: Callable[[Outer, OuterGains], bool] | None
    reach: Reach | None
    gain_dB: float
    phase_deg: float
    filters: dict[Filter, StationaryFilter] = field(default_factory=dict)
    """The same with every regulator."""

    @cached_property
    def plant(self) -> System:
        """The model with its delay."""
        return model_system(self.model, self.period_s)

    @cached_property
    def omega(self) -> Array:
        """Frequencies (n,), rad/s, up to half the rate of the samples."""
        return grid(self.sample_cycles * self.period_s, np.power(self.plant.poles, self.sample_cycles))

    @cached_property
    def squared(self) -> Array:
        """Of the model's response (n,) at them."""
        return np.asarray(np.abs(self.plant.response(self.omega)) ** 2)

    @property
    def at_once(self) -> bool:
        """Whether a sample of every cycle is seen in it; behind a bus a closed loop is measured over fewer lines."""
        return self.sample_cycles == 1 and self.late_cycles == 0

    def regulator(self, weight: float) -> tuple[Outer, OuterGains, StepAnswer]:
        """With any filter: the regulator is the same with all."""
        outer = Outer(
            model=self.model,
            control_weight=float(f"{weight:.4g}"),
            oscillation_Hz=self.oscillation_Hz,
            sensor_noise_um=float(f"{max(self.noise_um, 1e-4):.3g}"),
            sample_cycles=self.sample_cycles,
        )
        gains = outer_gains(outer, None, self.period_s)
        controllable = len(self.model.A) + self.model.delay_cycles
        return outer, gains, predicted_step(gains, controllable, self.period_s, _STEP_S)

    def chain(self, outer: Outer, gains: OuterGains, input_um: float) -> Iterator[Candidate]:
        """One regulator with ever faster filters, as far as they are worth a closer look."""
        late = _LATE_OSCILLATION if self.late_cycles else _OSCILLATION
        for walk in _WALKS_UM:
            pair = self.pair(outer, gains, Filter(walk, late * walk, input_um))
            if pair is not None:
                yield pair

    def pair(self, outer: Outer, gains: OuterGains, filtering: Filter) -> Candidate | None:
        """One regulator with one filter; None where it is not worth a closer look."""
        filtered = outer.model_copy(update=filtering.figures)
        if filtering not in self.filters:
            A, _, C, controllable = augment(outer, self.period_s)
            self.filters[filtering] = stationary_filter(filtered, A, C, controllable)
        with_filter = replace(gains, **self.filters[filtering]._asdict())
        loop = stage_loop(with_filter, self.plant, self.sample_cycles, self.late_cycles)
        if np.abs(np.linalg.eigvals(loop.closed())).max() >= 1.0:
            return None
        L = loop.response(self.omega)
        if np.abs(1.0 + L).min() * HOPELESS < 1.0:
            return None
        size = np.abs(L)
        crossed = self.omega[:-1][(size[:-1] - 1.0) * (size[1:] - 1.0) < 0.0] / (2 * np.pi)
        bandwidth_Hz = highest_Hz(crossed.tolist(), self.oscillation_Hz)
        return Candidate(filtered, with_filter, filtering, loop, self.cost(L), bandwidth_Hz)

    def cost(self, L: Complex) -> float:
        """Mean square (um^2) of the stage under a wandering disturbance and the sensor's noise."""
        T, S = self.period_s, 1.0 / (1.0 + L)
        walk = (_DISTURBANCE_UM**2 / T) * self.squared * np.abs(S) ** 2 / self.omega**2
        noise = self.noise_um**2 * T * np.abs(L * S) ** 2
        return float(np.trapezoid(walk + noise, self.omega) / np.pi)

    def obstacle(self, candidate: Candidate, found: Margins) -> str | None:
        """What a pair does not hold; None where it holds everything."""
        if not found.stable or found.gain_dB < self.gain_dB + _RESERVE_DB:
            return "the gain margin"
        if found.phase_deg < self.phase_deg + _RESERVE_DEG:
            return "the phase margin"
        known = within(found, candidate.loop, self.unsure)
        if known.sensitivity > ROBUST or known.gain_dB < self.gain_dB:
            return UNKNOWN
        if not self._comes_to_rest(candidate.gains):
            return SLEWED
        return None if self.bears is None or self.bears(candidate.outer, candidate.gains) else FRAGILE

    def _comes_to_rest(self, gains: OuterGains) -> bool:
        if self.reach is None:
            return True
        samples = Samples(self.sample_cycles, self.late_cycles)
        return comes_to_rest(gains, len(self.model.A), self.reach, self.period_s, samples)


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
