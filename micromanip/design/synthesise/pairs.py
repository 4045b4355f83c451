"""Pairs of regulator and filter of the outer loop, and what one is judged by: its cost, and what it must hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from micromanip.control.margins import grid, refined
from micromanip.control.outer_gains import OuterGains, StationaryFilter, augment, outer_gains, stationary_filter
from micromanip.design.analyse.loops import stage_loop
from micromanip.settings.schema.axis import LinearModel, Outer

from ..analyse.loops import Margins, System
from ..analyse.saturation import Reach, Samples, comes_to_rest
from ..validate.step import StepAnswer, predicted_step

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_RESERVE_DB, _RESERVE_DEG = 0.3, 2.0
"""What is asked for beyond the least margins: the next identification gives a slightly other model."""
_WALKS_UM = np.geomspace(3e-6, 1.0, 21)
_OSCILLATION, _LATE_OSCILLATION = 1e-2, 1e-1
"""Noise of the tooth-passing oscillator in terms of the walk's; where samples come late integral action costs more."""
_DISTURBANCE_UM = 0.03
"""Random walk of the set-point, rms a cycle, that is to be removed: the tool's force, wandering."""
_BESIDE = 0.1
ROBUST, HOPELESS, _STEP_S = 3.0, 4.0, 0.2
UNKNOWN, FRAGILE = "Ms within what the measured response leaves open", "Ms over the plants drawn around the model"
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
    """What a pair is judged by: the model at frequencies (n,), and what is asked for."""

    model: LinearModel
    period_s: float
    noise_um: float
    oscillation_Hz: float | None
    sample_cycles: int
    late_cycles: int
    unsure: Callable[[Array], Array] | None
    bears: Callable[[Outer, OuterGains], bool]
    reach: Reach | None
    gain_dB: float
    phase_deg: float
    omega: Array
    plant: System
    squared: Array
    """Of the model's response, at the frequencies."""
    filters: dict[Filter, StationaryFilter] = field(default_factory=dict)
    """The same with every regulator."""

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
        if self.unsure is not None and _robust(candidate.loop, self.unsure) > ROBUST:
            return UNKNOWN
        if not self._comes_to_rest(candidate.gains):
            return SLEWED
        return None if self.bears(candidate.outer, candidate.gains) else FRAGILE

    def _comes_to_rest(self, gains: OuterGains) -> bool:
        if self.reach is None:
            return True
        samples = Samples(self.sample_cycles, self.late_cycles)
        return comes_to_rest(gains, len(self.model.A), self.reach, self.period_s, samples)


def _robust(loop: System, unsure: Callable[[Array], Array]) -> float:
    """Ms wherever within its uncertainty the plant may be."""
    omega, L = refined(loop.response, grid(loop.period_s, loop.poles))
    return float(1.0 / np.maximum(np.abs(1.0 + L) - np.abs(L) * unsure(omega), 1e-3).min())
