"""The outer loop by two human knobs: how fast (bandwidth), and how noisy the capacitive sensor is.

The LQG of `control/outer_gains.py` answers two questions that have little to do with one another. How the stage follows
its reference, and how a mode that was excited is damped, is the regulator's affair: the control weight. How quickly a
disturbance is noticed, and how far the model is trusted in that, is the filter's: random walk and noise of the
set-point, in terms of the sensor's noise. So both are searched: of all regulators whose step of the stage is as the
user accepts, and of all filters with each, the pair that leaves least of a disturbance and of the sensor's noise
together, with its margins, wherever within its uncertainty the plant may be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from micromanip.control.margins import grid, margins, refined
from micromanip.control.outer_gains import OuterGains, augment, observer_gain, outer_gains
from micromanip.design.loops import stage_loop
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import LinearModel, Outer

from ..loops import Margins, System, model_system
from ..step import StepAnswer, predicted_step

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

GAIN_DB, PHASE_DEG = 6.0, 35.0
OVERSHOOT, SETTLING_S = 0.4, 0.05
_RESERVE_DB, _RESERVE_DEG, _STEP_SHARE = 0.3, 2.0, 0.8
"""What is asked for beyond the least margins, and of what is accepted of the step: the next identification gives a
slightly other model."""
_CONTROL_WEIGHTS, _BETWEEN = np.geomspace(0.1, 1000.0, 9), (10.0**-0.25, 10.0**0.25)
"""Of a first look, and beside the best of it."""
_WALKS_UM, _INPUTS_UM = np.geomspace(3e-6, 1.0, 21), (1e-4, 1e-3, 1e-2, 1e-1)
_BESIDE = 0.1
_OSCILLATION, _LATE_OSCILLATION = 1e-2, 1e-1
"""Noise of the tooth-passing oscillator in terms of the walk's; where samples come late integral action costs more."""
_DISTURBANCE_UM = 0.03
"""Random walk of the set-point, rms a cycle, that is to be removed: the tool's force, wandering."""
_ROBUST, _HOPELESS, _STEP_S = 3.0, 4.0, 0.2
_UNKNOWN, _FRAGILE = "Ms within what the measured response leaves open", "Ms over the plants drawn around the model"


@dataclass(frozen=True)
class OuterDesign:
    """The tuning with its margins; `tried` has (weight, bandwidth_Hz, gain margin dB, phase margin deg) per design.

    `step` is what the model makes of the stage's step; `limited_by` says in words what stands in the way of more.
    """

    outer: Outer
    margins: Margins
    bandwidth_Hz: float
    tried: tuple[tuple[float, float, float, float], ...]
    step: StepAnswer
    limited_by: str


@dataclass(frozen=True)
class _Candidate:
    """A pair of regulator and filter, with its cost (um^2) and an estimate of its highest crossover."""

    outer: Outer
    gains: OuterGains
    loop: System
    cost: float
    bandwidth_Hz: float


def _highest_Hz(hertz: list[float] | tuple[float, ...], oscillation_Hz: float | None) -> float:
    """Highest crossover; the oscillator makes two of its own, which say nothing of the rest."""
    own = [f for f in hertz if oscillation_Hz is None or abs(f / oscillation_Hz - 1.0) > _BESIDE]
    return max(own or hertz, default=0.0)


def _any(_: Outer, __: OuterGains) -> bool:
    return True


@dataclass(frozen=True)
class _Task:
    """What a pair is judged by: the model at frequencies (n,), and what is asked for."""

    model: LinearModel
    period_s: float
    noise_um: float
    oscillation_Hz: float | None
    sample_cycles: int
    late_cycles: int
    unsure: Callable[[Array], Array] | None
    bears: Callable[[Outer, OuterGains], bool]
    gain_dB: float
    phase_deg: float
    omega: Array
    plant: System
    squared: Array
    """Of the model's response, at the frequencies."""
    observers: dict[tuple[float, float], tuple[Array, float]] = field(default_factory=dict)
    """By walk and noise of the set-point (um), the same with every regulator: gain, and the innovation's variance."""

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

    def chain(self, outer: Outer, gains: OuterGains, input_um: float) -> Iterator[_Candidate]:
        """One regulator with ever faster filters, as far as they are worth a closer look."""
        late = _LATE_OSCILLATION if self.late_cycles else _OSCILLATION
        A, _, C, controllable = augment(outer, self.period_s)
        for walk in _WALKS_UM:
            figures = {"disturbance_um": walk, "oscillation_um": late * walk, "input_noise_um": input_um}
            filtered = outer.model_copy(update={name: float(f"{um:.4g}") for name, um in figures.items()})
            if (walk, input_um) not in self.observers:
                self.observers[walk, input_um] = observer_gain(filtered, A, C, controllable)
            observer, variance = self.observers[walk, input_um]
            with_filter = replace(gains, observer=observer, innovation_variance=variance)
            loop = stage_loop(with_filter, self.plant, self.sample_cycles, self.late_cycles)
            if np.abs(np.linalg.eigvals(loop.closed())).max() >= 1.0:
                continue
            L = loop.response(self.omega)
            if np.abs(1.0 + L).min() * _HOPELESS < 1.0:
                continue
            size = np.abs(L)
            crossed = self.omega[:-1][(size[:-1] - 1.0) * (size[1:] - 1.0) < 0.0] / (2 * np.pi)
            cost = self.cost(L)
            yield _Candidate(filtered, with_filter, loop, cost, _highest_Hz(crossed.tolist(), self.oscillation_Hz))

    def cost(self, L: Complex) -> float:
        """Mean square (um^2) of the stage under a wandering disturbance and the sensor's noise."""
        T, S = self.period_s, 1.0 / (1.0 + L)
        walk = (_DISTURBANCE_UM**2 / T) * self.squared * np.abs(S) ** 2 / self.omega**2
        noise = self.noise_um**2 * T * np.abs(L * S) ** 2
        return float(np.trapezoid(walk + noise, self.omega) / np.pi)

    def obstacle(self, candidate: _Candidate, found: Margins) -> str | None:
        """What a pair does not hold; None where it holds everything."""
        if not found.stable or found.gain_dB < self.gain_dB + _RESERVE_DB:
            return "the gain margin"
        if found.phase_deg < self.phase_deg + _RESERVE_DEG:
            return "the phase margin"
        if self.unsure is not None and _robust(candidate.loop, self.unsure) > _ROBUST:
            return _UNKNOWN
        return None if self.bears(candidate.outer, candidate.gains) else _FRAGILE


def _robust(loop: System, unsure: Callable[[Array], Array]) -> float:
    """Ms wherever within its uncertainty the plant may be."""
    omega, L = refined(loop.response, grid(loop.period_s, loop.poles))
    return float(1.0 / np.maximum(np.abs(1.0 + L) - np.abs(L) * unsure(omega), 1e-3).min())


class _Search:
    """The best pair of those looked at so far, and what stood in the way of better ones."""

    def __init__(self, task: _Task, bandwidth_Hz: float | None) -> None:
        self._task, self._bandwidth_Hz = task, bandwidth_Hz
        self.best: tuple[float, _Candidate, Margins, StepAnswer] | None = None
        self.tried: list[tuple[float, float, float, float]] = []
        self.obstacles: list[str] = []

    def merit(self, candidate: _Candidate) -> float:
        """Less is better."""
        if self._bandwidth_Hz is None:
            return candidate.cost
        return abs(float(np.log(max(candidate.bandwidth_Hz, 1e-3) / self._bandwidth_Hz)))

    def look(self, regulators: list[tuple[Outer, OuterGains, StepAnswer]]) -> None:
        """Each regulator's filters, by halves: where one is too fast, so are those beyond it."""
        for outer, gains, step in regulators:
            for input_um in _INPUTS_UM:
                chain = list(self._task.chain(outer, gains, input_um))
                while chain:
                    least = np.inf if self.best is None else self.best[0]
                    chain = [each for each in chain if self.merit(each) < least]
                    if not chain:
                        break
                    k = len(chain) // 2
                    found = margins(chain[k].loop)
                    crossover = _highest_Hz(found.crossovers_Hz, self._task.oscillation_Hz)
                    self.tried.append((outer.control_weight, crossover, found.gain_dB, found.phase_deg))
                    obstacle = self._task.obstacle(chain[k], found)
                    if obstacle is None:
                        self.best = self.merit(chain[k]), chain[k], found, step
                    else:
                        self.obstacles.append(obstacle)
                        chain = chain[:k]


def tune_outer(
    model: LinearModel,
    period_s: float,
    noise_um: float,
    *,
    unsure: Callable[[Array], Array] | None = None,
    bears: Callable[[Outer, OuterGains], bool] = _any,
    gain_dB: float = GAIN_DB,
    phase_deg: float = PHASE_DEG,
    overshoot: float = OVERSHOOT,
    settling_s: float = SETTLING_S,
    bandwidth_Hz: float | None = None,
    oscillation_Hz: float | None = 200.0,
    sample_cycles: int = 1,
    late_cycles: int = 0,
) -> OuterDesign:
    """The outer loop for `model` that leaves least, with at least 6 dB and 35 degrees, or the one of `bandwidth_Hz`.

    `noise_um` is the sensor's rms; `bandwidth_Hz` the highest crossover of the loop; a sample is seen
    `late_cycles` after it was taken. The stage's step is to stay below `overshoot` (a share of it) and settle within
    `settling_s`, with a reserve; where no loop does, the one that comes nearest is taken, and said. `unsure` gives the
    uncertainty of the model's response at angular frequencies as a share of it: wherever the plant is within, Ms stays
    below 3. `bears` is asked whether a design that has its margins also bears what else it must. Raises CheckFailed
    where the margins are not to be had, with what is.
    """
    plant = model_system(model, period_s)
    sampled = sample_cycles * period_s
    omega = grid(sampled, np.power(plant.poles, sample_cycles))
    response = np.abs(plant.response(omega)) ** 2
    task = _Task(
        model, period_s, noise_um, oscillation_Hz, sample_cycles, late_cycles, unsure, bears, gain_dB, phase_deg,
        omega, plant, response,
    )  # fmt: skip

    def excess(step: StepAnswer) -> float:
        return max(step.overshoot / max(overshoot, 0.01), step.settling_s / settling_s) / _STEP_SHARE

    regulators = sorted((task.regulator(weight) for weight in _CONTROL_WEIGHTS), key=lambda each: excess(each[2]))
    good = [each for each in regulators if excess(each[2]) <= 1.0]
    search = _Search(task, bandwidth_Hz)
    search.look(good)
    if search.best is not None:
        beside = [task.regulator(search.best[1].outer.control_weight * factor) for factor in _BETWEEN]
        search.look([each for each in beside if excess(each[2]) <= 1.0])
    for regulator in regulators[len(good) :]:
        if search.best is not None:
            break
        search.look([regulator])
    best = search.best
    asked = "" if bandwidth_Hz is None else f" at {bandwidth_Hz:g} Hz"
    if best is None or (bandwidth_Hz is not None and best[1].bandwidth_Hz < 0.8 * bandwidth_Hz):
        raise CheckFailed(_refused(search, asked, gain_dB, phase_deg))
    _, candidate, found, step = best
    crossover = _highest_Hz(found.crossovers_Hz, oscillation_Hz)
    limited = _limited(step, excess(step) <= 1.0, search.obstacles)
    return OuterDesign(candidate.outer, found, crossover, tuple(search.tried), step, limited)


def _limited(step: StepAnswer, good: bool, obstacles: list[str]) -> str:
    """What stands in the way of more, and what would help."""
    if not good:
        return (
            f"the step limits it: no regulator with its margins does better than {100 * step.overshoot:.0f} % of "
            f"overshoot and {1e3 * step.settling_s:.0f} ms: a stiffer or better damped flexure, or less delay, would "
            "allow more"
        )
    if not obstacles:
        return "nothing limits it: faster loops would only pass on more of the sensor's noise"
    most = max(set(obstacles), key=obstacles.count)
    helps = {
        _UNKNOWN: "a response measured with less noise",
        _FRAGILE: "more damping of the flexure's mode, less delay",
    }
    return f"{most} limits it: {helps.get(most, 'less delay, or a stiffer flexure,')} would allow more"


def _refused(search: _Search, asked: str, gain_dB: float, phase_deg: float) -> str:
    """Why there is no loop."""
    if not asked and _FRAGILE in search.obstacles:
        return (
            "outer loops have their margins around the model, but not over the plants drawn around it: more "
            "damping of the flexure's mode, or less delay, would help; or allow more in accept.robust_sensitivity"
        )
    if not asked and _UNKNOWN in search.obstacles:
        return (
            f"outer loops have their margins around the model, but Ms is above {_ROBUST:g} somewhere within what "
            "the measured response leaves open: measure with less noise, or ask for a calmer loop with --noise"
        )
    if not search.tried:
        return f"no outer loop{asked} is stable with Ms below {_HOPELESS:g}: identify the model again"
    closest = max(search.tried, key=lambda entry: min(entry[2] - gain_dB, (entry[3] - phase_deg) / 6.0))
    return (
        f"no outer loop{asked} has margins of {gain_dB:g} dB and {phase_deg:g} deg; the best has "
        f"{closest[2]:.1f} dB and {closest[3]:.0f} deg at {closest[1]:.0f} Hz: ask for less bandwidth, or identify "
        "the model again"
    )
