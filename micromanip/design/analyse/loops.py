"""Margins of both loops for plants drawn around the nominal one, in parallel through joblib.

A sample is known by its seed: the same seed gives the same plant whatever else is drawn, on any worker. Run inside
``design.parallel.scheduler``, the samples go to a Dask cluster.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
from scipy.linalg import eigvals

from micromanip.control.margins import Margins, margins
from micromanip.control.outer_gains import OuterGains
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import stage_loop
from micromanip.control.system import Complex, System, delay
from micromanip.settings.schema.axis import Inner, LinearModel
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

from ..identify.linear import Modes
from ..parallel import each
from .describing import harmonics, inverse_operator

_LIGHTLY, _NEAR = 0.3, 0.3


@dataclass(frozen=True)
class Perturbation:
    """Factors on the nominal plant, and a delay (cycles) that is added to its own.

    ``swing`` and ``place`` say where on the hysteresis the actuator is: amplitude and offset as shares of what the
    set-point's range has room for.
    """

    stage_mass: float = 1.0
    stiffness: float = 1.0
    damping: float = 1.0
    delay_cycles: float = 0.0
    piezo_gain: float = 1.0
    hysteresis_gain: float = 1.0
    swing: float = 0.0
    place: float = 0.5


SPREAD = Perturbation(
    stage_mass=0.2, stiffness=0.15, damping=0.5, delay_cycles=0.5, piezo_gain=0.2, hysteresis_gain=0.3
)
"""Half widths: +-20 % of mass, +-15 % of stiffness, +-50 % of damping, half a cycle, +-20 % and +-30 % of gains."""


def draw(seed: int) -> Perturbation:
    """The perturbation of `seed`: each figure uniform within ``SPREAD``, the place on the hysteresis anywhere."""
    rng = np.random.default_rng(seed)
    values = {}
    for name, width in asdict(SPREAD).items():
        share = rng.uniform(-1.0, 1.0)
        if name in ("swing", "place"):
            values[name] = 0.5 + 0.5 * share
        else:
            values[name] = (0.0 if name == "delay_cycles" else 1.0) + width * share
    return Perturbation(**values)


def residues(system: System) -> tuple[Complex, Complex]:
    """Poles (n,) and residues (n,) of a system without direct term: ``G(z) = sum r / (z - p)``."""
    poles, vectors = np.linalg.eig(system.A)
    driven = np.linalg.solve(vectors, system.B.astype(complex))
    return poles.astype(complex), np.asarray((system.C @ vectors) * driven)


def damped(root: complex, period_s: float) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio of a discrete pole or zero."""
    rate = np.log(complex(root)) / period_s
    return float(abs(rate) / (2 * np.pi)), float(-rate.real / abs(rate))


def flexure_mode(poles: Complex, strengths: Complex) -> int | None:
    """Index of the slowest pole above the real axis that is lightly damped; None where nothing oscillates."""
    rates = np.log(poles)
    light = (poles.imag > 1e-9) & (np.abs(strengths) > 0.0) & (-rates.real < _LIGHTLY * np.abs(rates))
    if not light.any():
        return None
    return int(np.argmin(np.where(light, np.abs(rates), np.inf)))


def antiresonance(system: System, pole: complex) -> complex | None:
    """The zero that lies by the oscillating `pole`, where there is one: the stage swinging on a held actuator."""
    n = len(system.A)
    pencil = np.block([[system.A, system.B[:, None]], [system.C[None, :], np.zeros((1, 1))]])
    zeros = np.asarray(eigvals(pencil, np.diag([1.0] * n + [0.0])), dtype=complex)
    zeros = zeros[np.isfinite(zeros) & (zeros.imag > 1e-9) & (np.abs(zeros) < 1.0)]
    if not len(zeros):
        return None
    nearest = complex(zeros[np.argmin(np.abs(zeros - pole))])
    return nearest if abs(np.log(nearest) / np.log(pole) - 1.0) < _NEAR else None


def _moved(root: complex, p: Perturbation) -> complex:
    """An oscillating pole or zero with the frequency and damping ratio that `p` gives it."""
    rate = np.log(root)
    size = abs(rate) * np.sqrt(p.stiffness / p.stage_mass)
    ratio = min(p.damping * -rate.real / abs(rate), 0.999)
    return complex(np.exp(size * (-ratio + 1j * np.sqrt(1.0 - ratio * ratio))))


def _pair(z: Complex, root: complex) -> Complex:
    return np.asarray((z - root) * (z - np.conj(root)))


@dataclass(frozen=True)
class Shift:
    """How a perturbation moves the flexure mode of a system, and the antiresonance by it (None: there is none)."""

    pole: complex
    new_pole: complex
    zero: complex | None
    new_zero: complex | None

    def zeros_alone(self, z: Complex) -> Complex:
        """Factor of the moved antiresonance."""
        if self.zero is None or self.new_zero is None:
            return np.ones_like(z)
        return _pair(z, self.new_zero) / _pair(z, self.zero)

    def poles_only(self) -> Shift:
        """The same with the antiresonance left where it is."""
        return Shift(self.pole, self.new_pole, None, None)


def shift(system: System, p: Perturbation) -> Shift | None:
    """What `p` does to the flexure mode of `system`; None where it has none."""
    poles, strengths = residues(system)
    k = flexure_mode(poles, strengths)
    if k is None:
        return None
    pole = complex(poles[k])
    zero = antiresonance(system, pole)
    return Shift(pole, _moved(pole, p), zero, None if zero is None else _moved(zero, p))


def shifted(system: System, moved: Shift) -> System:
    """`system` times the ratio of second-order sections that moves its mode; its static gain is kept.

    Expanded into residues, so that no pole is left that a zero only cancels.
    """
    poles, strengths = residues(system)
    old, new = moved.pole, moved.new_pole
    k, pair = (int(np.abs(poles - root).argmin()) for root in (old, np.conj(old)))
    kept = np.delete(np.arange(len(poles)), [k, pair])
    one, at, q = np.array([1.0 + 0j]), np.array([new]), poles[kept]
    scale = (_pair(one, new) / _pair(one, old) / moved.zeros_alone(one)).real[0]
    # G (z - old)(z - old*) at the new pole, without the division by zero where it has hardly moved
    rest = _pair(at, old) * np.sum(strengths[kept] / (new - q))
    rest = rest + strengths[k] * (new - np.conj(old)) + strengths[pair] * (new - old)
    own = scale * rest * moved.zeros_alone(at) / (2j * new.imag)
    others = strengths[kept] * scale * _pair(q, old) / _pair(q, new) * moved.zeros_alone(q)
    poles, strengths = np.concatenate([q, at]), np.concatenate([others, own])
    first = poles.imag > -1e-12
    drive, zero = np.ones((int(first.sum()), 1), complex), np.zeros((1, 1))
    A, B, C, _ = Modes(poles[first], drive, strengths[first][None, :], zero).state_space()
    return System(A, B[:, 0], C[0], 0.0, system.period_s)


def section_ratio(moved: Shift, period_s: float) -> System:
    """The ratio of the mode's second-order sections alone, moved over nominal, with static gain 1."""
    one, new = np.array([1.0 + 0j]), moved.new_pole
    scale = float((_pair(one, new) / _pair(one, moved.pole)).real[0])
    strength = scale * _pair(np.array([new]), moved.pole)[0] / (2j * new.imag)
    A = np.array([[new.real, -new.imag], [new.imag, new.real]])
    return System(A, np.array([1.0, 0.0]), 2.0 * np.array([strength.real, -strength.imag]), scale, period_s)


def perturbed(system: System, p: Perturbation) -> System:
    """`system` with its flexure mode, and the antiresonance by it, moved as another stage would.

    The stage on its flexure follows the actuator through ``w^2 / (s^2 + 2 d w s + w^2)``, whose w and d a mass, a
    stiffness and a damping change; the response to the force on the actuator has both its poles and its zeros there.
    """
    moved = shift(system, p)
    return system if moved is None else shifted(system, moved)


def model_dynamics(model: LinearModel, period_s: float) -> System:
    """The configuration's plant, set-point to stage, without its delay."""
    return System(np.array(model.A), np.array(model.B), np.array(model.C), 0.0, period_s)


def over_path(actuator: System, path: FeedbackPath) -> System:
    """`actuator` as the PID sees it over a bus: late, and a step from sample to sample."""
    late = path.strain_late + path.output_late
    behind = delay(late, actuator.period_s).then(actuator) if late else actuator
    return behind.resampled(path.strain_cycles)


def strain_loop(inner: Inner, actuator: System, slope: float = 1.0) -> System:
    """Loop transfer, broken at the voltage; `slope` is the actuator's gain as a multiple of that of `actuator`.

    The PID steps at the period of `actuator`: behind a bus that is what `over_path` makes of it.
    """
    return pid_system(inner, actuator.period_s).then(actuator.scaled(slope))


def closed_ratio(
    inner: Inner, actuator: System, moved: Shift | None, late: System, slope: float, own: System | None = None
) -> System:
    """What other mechanics, delay or slope inside the closed strain loop make of the plant outside: G'/G.

    With PID C and actuator P, the set-point reaches the stage through ``P (F + C) / (1 + P C)`` (F the feedforward)
    and the flexure, whose resonance is P's antiresonance. With another stage and slope g the ratio is

        G'/G = g s (1 + P C) / (1 + g P' C)

    with s the ratio of the sections of P's own mode. `own` is the delay of P (None: none), `late` that of P'. The PID
    has one copy of its states, so that no integrator is left that is only cancelled.
    """
    pid = pid_system(inner, actuator.period_s)
    behind = actuator if moved is None else shifted(actuator, moved)
    ahead = actuator if moved is None else shifted(actuator, moved.poles_only())
    ahead = ahead if own is None else own.then(ahead)
    section = None if moved is None else section_ratio(moved, actuator.period_s)
    back = late.then(behind).scaled(slope)
    sizes = [len(pid.A), len(back.A), len(ahead.A), 0 if section is None else len(section.A)]
    i, j, k, n = np.cumsum(sizes)
    A, B, C = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    # w = u - back(c), c = pid(w), output slope (section(w) + ahead(c)); `back` never feeds through
    A[:i, :i], A[:i, i:j], B[:i] = pid.A, -np.outer(pid.B, back.C), pid.B
    c_from_x = np.concatenate([pid.C, -pid.D * back.C])
    for first, last, block in ((i, j, back), (j, k, ahead)):
        A[first:last, first:last] += block.A
        A[first:last, :j] += np.outer(block.B, c_from_x)
        B[first:last] = block.B * pid.D
    C[j:k] = slope * ahead.C
    direct = slope
    if section is not None:
        A[k:, k:], A[k:, i:j], B[k:] = section.A, -np.outer(section.B, back.C), section.B
        C[k:] = slope * section.C
        direct = slope * section.D
    C[i:j] = -direct * back.C
    return System(A, B, C, direct, actuator.period_s)


HELD_SENSITIVITY = 4.0
"""Largest Ms of an outer loop at any slope of the hysteresis, the feedforward held: as bad as an inverse can be."""
_SMALLEST_UM = 0.5
_UNSTABLE = Margins(1.0, 1.0, 0.0, np.nan, 0.0, 0.0, np.nan, (), np.inf)


@dataclass(frozen=True)
class StrainSide:
    """What the strain loop is made of: PID, actuator (volts to um), and its hysteresis for the range of slopes."""

    inner: Inner
    actuator: System
    hysteresis: PrandtlIshlinskii | None
    range_um: Range
    identified_slope: float
    path: FeedbackPath = AT_ONCE
    own_delay: int = 0
    """Cycles of the actuator's delay, which its dynamics lack."""

    def slope(self, p: Perturbation) -> float:
        """Slope of the actuator as a multiple of the identified one; nan where its hysteresis has no inverse."""
        if self.hysteresis is None:
            return p.piezo_gain
        weights = tuple(p.hysteresis_gain * w for w in self.hysteresis.weights)
        if self.hysteresis.alpha + np.cumsum(weights).min(initial=0.0) <= 0.0:
            return np.nan
        low, high = self.range_um
        offset = low + p.place * (high - low)
        room = max(min(offset - low, high - offset), 2.0 * _SMALLEST_UM)
        amplitude = _SMALLEST_UM * (room / _SMALLEST_UM) ** p.swing
        operator = inverse_operator(self.hysteresis.model_copy(update={"weights": weights}))
        return p.piezo_gain / (self.identified_slope * abs(harmonics(operator, amplitude, offset).gain))


@dataclass(frozen=True)
class StageSide:
    """What the outer loop is made of: the compensator's gains, and the plant that it was made for."""

    gains: OuterGains
    model: LinearModel
    sample_cycles: int
    late_cycles: int = 0


@dataclass(frozen=True)
class Sample:
    """One plant: its seed, what was drawn, and the margins of the loops that there are."""

    seed: int
    drawn: Perturbation
    strain: Margins | None
    stage: Margins | None

    @property
    def stable(self) -> bool:
        """Every loop that there is, is stable."""
        return all(loop.stable for loop in (self.strain, self.stage) if loop is not None)


def drawn_plant(drawn: Perturbation, strain: StrainSide | None, model: LinearModel, period_s: float) -> System | None:
    """Set-point to stage of a drawn plant; None where its hysteresis has no inverse."""
    dynamics = model_dynamics(model, period_s)
    mechanics = perturbed(dynamics, drawn)
    if strain is not None:
        slope = strain.slope(drawn)
        if not np.isfinite(slope):
            return None
        late = delay(max(0.0, strain.own_delay + drawn.delay_cycles), period_s)
        own, moved = delay(strain.own_delay, period_s), shift(strain.actuator, drawn)
        mechanics = closed_ratio(strain.inner, strain.actuator, moved, late, slope, own).then(dynamics)
    return delay(max(0.0, model.delay_cycles + drawn.delay_cycles), period_s).then(mechanics)


def held_plant(slope: float, strain: StrainSide, model: LinearModel, period_s: float) -> System:
    """Set-point to stage where the actuator's slope is another while the feedforward keeps its own.

    An inverse that fits changes its slope with the actuator, and the loop stays the nominal one; this is the worst that
    one can be which does not.
    """
    own = delay(strain.own_delay, period_s)
    ratio = closed_ratio(strain.inner, strain.actuator, None, own, slope, own)
    return delay(model.delay_cycles, period_s).then(ratio.then(model_dynamics(model, period_s)))


def sample(seed: int, strain: StrainSide | None, stage: StageSide | None, period_s: float) -> Sample:
    """Draw the plant of `seed` and take the margins of its loops."""
    drawn = draw(seed)
    slope = strain.slope(drawn) if strain else 1.0
    if not np.isfinite(slope):
        return Sample(seed, drawn, _UNSTABLE if strain else None, _UNSTABLE if stage else None)
    inner = outer = None
    if strain is not None:
        # a model without a delay of its own has what there is in its states: it can only be added to
        late = delay(max(0.0, strain.own_delay + drawn.delay_cycles), period_s)
        behind = late.then(perturbed(strain.actuator, drawn))
        inner = margins(strain_loop(strain.inner, over_path(behind, strain.path), slope))
    plant = None if stage is None else drawn_plant(drawn, strain, stage.model, period_s)
    if stage is not None and plant is not None:
        outer = margins(stage_loop(stage.gains, plant, stage.sample_cycles, stage.late_cycles))
    return Sample(seed, drawn, inner, outer)


def monte_carlo(
    strain: StrainSide | None, stage: StageSide | None, period_s: float, seeds: range, jobs: int | None = None
) -> Iterator[Sample]:
    """A sample a seed, in the order of the seeds."""
    return each(partial(sample, strain=strain, stage=stage, period_s=period_s), seeds, jobs)


def worst(samples: list[Sample], of_stage: bool) -> Sample:
    """The sample whose outer loop (or strain loop) has the largest Ms; unstable ones before all others."""

    def badness(case: Sample) -> tuple[bool, float]:
        loop = case.stage if of_stage else case.strain
        if loop is None:
            raise ValueError("the samples have no such loop")
        return not loop.stable, loop.radius if not loop.stable else loop.sensitivity

    return max(samples, key=badness)
