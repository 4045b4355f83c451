"""Plants near the nominal one: what may be different about mechanics, delay, piezo and hysteresis, drawn by a seed."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.linalg import eigvals

from micromanip.control.system import Complex, System, delay
from micromanip.design.identify.linear import Modes
from micromanip.settings.schema.axis import LinearModel

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

    def factors(self) -> dict[str, float]:
        """Name and value of each."""
        return asdict(self)


SPREAD = Perturbation(
    stage_mass=0.2, stiffness=0.15, damping=0.5, delay_cycles=0.5, piezo_gain=0.2, hysteresis_gain=0.3
)
"""Half widths: +-20 % of mass, +-15 % of stiffness, +-50 % of damping, half a cycle, +-20 % and +-30 % of gains."""


def draw(seed: int) -> Perturbation:
    """The perturbation of `seed`: each figure uniform within ``SPREAD``, the place on the hysteresis anywhere."""
    rng = np.random.default_rng(seed)
    values = {}
    for name, width in SPREAD.factors().items():
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


def perturbed_delay(model: LinearModel, p: Perturbation, period_s: float) -> System:
    """The plant's delay, with that of `p` added."""
    return delay(max(0.0, model.delay_cycles + p.delay_cycles), period_s)
