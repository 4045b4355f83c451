"""Drawn plants: what a perturbation does to the models is what the same change does to the physics."""

import numpy as np
import pytest
from rt.builders import PERIOD_S
from rt.outer_loops import designed
from scipy.linalg import expm

from micromanip.control.margins import margins
from micromanip.control.pid import pid_system
from micromanip.control.system import System, delay
from micromanip.design.analyse.loops import (
    SPREAD,
    Perturbation,
    StageSide,
    StrainSide,
    closed_ratio,
    draw,
    monte_carlo,
    perturbed,
    section_ratio,
    shift,
    strain_loop,
)
from micromanip.settings.schema.axis import Inner
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii

OMEGA = 2 * np.pi * np.geomspace(2.0, 1500.0, 200)
PID = Inner(mode="pid", K_V_per_um=0.6, Ti_ms=0.571, Td_ms=0.167, filter_ms=0.3)


def held(A, B, C):
    """Zero-order hold of a continuous model."""
    n = len(A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, B
    step = expm(block * PERIOD_S)
    return System(step[:n, :n], step[:n, n], np.array(C, dtype=float), 0.0, PERIOD_S)


def stage(mass=1.0, stiffness=1.0, damping=1.0):
    """Stage on its flexure behind an actuator of 300 Hz."""
    omega, zeta, pole = 2 * np.pi * 66.0 * np.sqrt(stiffness / mass), 0.02 * damping, 2 * np.pi * 300.0
    A = np.array([[-pole, 0.0, 0.0], [0.0, 0.0, omega], [5.0 * omega, -omega, -2 * zeta * omega]])
    return held(A, [pole, 0.0, 0.0], [0.0, 1.0, 0.0])


def actuator(mass=1.0, stiffness=1.0, damping=1.0):
    """Strain over voltage: mode at 63 Hz, antiresonance at 67 Hz, amplifier of 900 Hz; both move with the stage."""
    scale = np.sqrt(stiffness / mass)
    pole, zero = (2 * np.pi * f * scale for f in (63.0, 67.0))
    zeta, lag = 0.04 * damping, 2 * np.pi * 900.0
    # 1 + (difference of the sections) in controllable form, behind the amplifier
    gain = (pole / zero) ** 2
    b1 = 2 * zeta * gain * zero - 2 * zeta * gain * pole
    b0 = gain * zero**2 - gain * pole**2
    A = np.array([[0.0, 1.0, 0.0], [-(pole**2), -2 * zeta * pole, 1.0], [0.0, 0.0, -lag]])
    return held(A, [0.0, 0.0, 0.6 * lag], [b0, b1, gain])


CHANGES = [
    {"mass": 0.8},
    {"mass": 1.2, "stiffness": 0.9},
    {"damping": 0.5},
    {"damping": 1.5, "mass": 0.9, "stiffness": 1.1},
    {"mass": 1.0 + 1e-9},
]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("plant", [stage, actuator])
def test_moving_the_mode_is_changing_the_physics(plant, change):
    """To what sampling does to a zero: below 0.5 % up to 1.5 kHz."""
    names = {"mass": "stage_mass"}
    p = Perturbation(**{names.get(key, key): value for key, value in change.items()})
    moved = perturbed(plant(), p).response(OMEGA)
    assert np.abs(moved / plant(**change).response(OMEGA) - 1.0).max() < 5e-3
    assert perturbed(plant(), p).response(np.zeros(1)) == pytest.approx(plant().response(np.zeros(1)), rel=1e-9)


@pytest.mark.parametrize("slope", [0.8, 1.0, 1.3])
@pytest.mark.parametrize("late", [0.0, 0.4, 1.0])
def test_closed_ratio_is_its_formula(slope, late):
    P, C, p = actuator(), pid_system(PID, PERIOD_S), Perturbation(stage_mass=0.85, damping=0.7)
    moved, lag = shift(P, p), delay(late, PERIOD_S)
    L = P.response(OMEGA) * C.response(OMEGA)
    L_moved = lag.response(OMEGA) * slope * perturbed(P, p).response(OMEGA) * C.response(OMEGA)
    expected = slope * section_ratio(moved, PERIOD_S).response(OMEGA) * (1 + L) / (1 + L_moved)
    found = closed_ratio(PID, P, moved, lag, slope)
    assert found.response(OMEGA) == pytest.approx(expected, rel=1e-8)
    assert found.response(np.array([1e-3])) == pytest.approx(1.0, abs=1e-4), "integral action: no change at rest"


def test_closed_ratio_is_stable_exactly_when_the_strain_loop_is():
    """The strain loop takes damping from the mode: with too little of it, both say unstable."""
    P = actuator()
    radii = []
    for damping in (1.0, 0.6, 0.2, 0.05):
        p = Perturbation(damping=damping)
        loop = margins(strain_loop(PID, perturbed(P, p)))
        ratio = closed_ratio(PID, P, shift(P, p), delay(0.0, PERIOD_S), 1.0)
        assert (np.abs(ratio.poles).max() < 1.0) == loop.stable
        radii.append(loop.radius)
    assert radii[0] < 1.0 < radii[-1]


def test_draws_stay_in_their_spread_and_follow_their_seed():
    drawn = [draw(seed) for seed in range(300)]
    assert draw(7) == draw(7)
    assert draw(7) != draw(8)
    for name, width in SPREAD.factors().items():
        values = np.array([d.factors()[name] for d in drawn])
        centre = {"delay_cycles": 0.0, "swing": 0.5, "place": 0.5}.get(name, 1.0)
        width = 0.5 if name in ("swing", "place") else width
        assert np.abs(values - centre).max() <= width
        assert np.abs(values - centre).max() > 0.95 * width
        assert abs(values.mean() - centre) < 0.15 * width


def sides(weights=(0.08, 0.07, 0.06)):
    settings, gains, _ = designed(2)
    model = PrandtlIshlinskii(
        model="pi",
        range_um=(2, 128),
        shaping="affine",
        coefficients=(0.63, 0.0),
        thresholds_um=(3.5, 7.0, 10.5),
        weights=weights,
    )
    return (StrainSide(PID, actuator(), model, (2.0, 128.0), 0.63), StageSide(gains, settings.model, 1))


def test_hysteresis_without_an_inverse_counts_as_unstable():
    strain, stage_side = sides(weights=(-0.5, -0.4, 0.06))
    assert np.isnan(strain.slope(Perturbation(hysteresis_gain=1.3)))
    seed = next(s for s in range(100) if draw(s).hysteresis_gain > 1.2)
    (found,) = monte_carlo(strain, stage_side, PERIOD_S, range(seed, seed + 1), 1)
    assert not found.stable
