"""Both loops as systems: they are what runs, and their margins are those of the design table."""

from dataclasses import asdict

import numpy as np
import pytest
from rt.builders import PERIOD_S, record
from rt.outer_loops import designed
from scipy.linalg import expm

from campaigns.report import CONFIG
from micromanip.control.margins import margins
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import System, delay
from micromanip.design.analyse.loops import (
    SPREAD,
    Perturbation,
    StageSide,
    StrainSide,
    closed_ratio,
    draw,
    held_plant,
    monte_carlo,
    over_path,
    perturbed,
    section_ratio,
    shift,
    strain_loop,
)
from micromanip.rt.laws.pid import PID_PARAMETERS, PID_STATE, pid_output
from micromanip.settings.schema.axis import Inner, LinearModel
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

OMEGA = 2 * np.pi * np.geomspace(2.0, 1500.0, 200)


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
    for name, width in asdict(SPREAD).items():
        values = np.array([getattr(d, name) for d in drawn])
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


PAPER = CONFIG / "paper.yaml"
PID = Inner(mode="pid", K_V_per_um=0.6, Ti_ms=0.571, Td_ms=0.167, filter_ms=0.3)


def simulated(system, u):
    x, y = np.zeros(len(system.A)), np.empty(len(u))
    for k, value in enumerate(u):
        y[k] = system.C @ x + system.D * value
        x = system.A @ x + system.B * value
    return y


def test_the_pid_is_the_one_that_runs():
    p = record(
        PID_PARAMETERS,
        K_V_per_um=PID.K_V_per_um,
        period_s=PERIOD_S,
        integral=PID.K_V_per_um * PERIOD_S / (PID.Ti_ms * 1e-3),
        derivative=PID.K_V_per_um * PID.Td_ms * 1e-3,
        filter_s=PID.filter_ms * 1e-3,
        most_periods=1,
    )
    s, e = record(PID_STATE), np.random.default_rng(1).normal(size=300)
    running = [pid_output(p, s, float(value), 1) for value in e]
    assert simulated(pid_system(PID, PERIOD_S), e) == pytest.approx(running, abs=1e-12)


def test_at_another_slope_the_feedforward_keeps_its_own():
    """``g P (F + C) / (1 + g P C)`` over that of the slope 1, F the inverse of P at rest."""
    P, F = System(np.array([[0.7]]), np.array([0.3]), np.array([0.6]), 0.0, PERIOD_S), 1.0 / 0.6
    side = StrainSide(PID, P, None, (0.0, 1.0), 0.6)
    model = LinearModel(A=[[0.9]], B=[0.1], C=[5.0], delay_cycles=0)
    omega = np.geomspace(10.0, 3e4, 30)
    C, G = pid_system(PID, PERIOD_S).response(omega), P.response(omega)

    def around(slope):
        return slope * G * (F + C) / (1.0 + slope * G * C)

    nominal = held_plant(1.0, side, model, PERIOD_S).response(omega)
    assert nominal == pytest.approx(model_system(model, PERIOD_S).response(omega), rel=1e-9)
    for slope in (0.4, 1.7):
        found = held_plant(slope, side, model, PERIOD_S).response(omega)
        assert found / nominal == pytest.approx(around(slope) / around(1.0), rel=1e-9)


@pytest.mark.parametrize(("sample_cycles", "late"), [(1, 0), (10, 0), (10, 3), (10, 10), (5, 5)])
@pytest.mark.parametrize("oscillation_Hz", [None, 200.0])
def test_closed_outer_loop_has_the_poles_of_regulator_and_observer(sample_cycles, late, oscillation_Hz):
    """Also where samples come late: each corrects the estimate of its own time."""
    settings, gains, _ = designed(2, sample_cycles=sample_cycles, oscillation_Hz=oscillation_Hz)
    loop = stage_loop(gains, model_system(settings.model, PERIOD_S), sample_cycles, late)
    closed = np.linalg.eigvals(loop.closed())
    controllable = len(settings.model.A) + 2
    regulator, observer = gains.closed_loop_poles[:controllable], gains.closed_loop_poles[controllable:]
    for value in [*regulator**sample_cycles, *observer]:
        if abs(value) > 0.3:  # the delay's poles at 0 are badly conditioned
            assert np.abs(closed - value).min() < 1e-4
    assert np.abs(closed).max() == pytest.approx(
        max(np.abs(regulator).max() ** sample_cycles, np.abs(observer).max()), abs=1e-6
    )


def test_over_a_bus_the_pid_steps_from_sample_to_sample_and_late():
    plant = System(np.array([[0.7]]), np.array([0.3]), np.array([2.0]), 0.0, PERIOD_S)
    path = FeedbackPath(strain_cycles=5, strain_late=3, output_late=4)
    seen = over_path(plant, path)
    u = np.random.default_rng(2).normal(size=40)
    assert simulated(seen, u) == pytest.approx(
        simulated(delay(7, PERIOD_S).then(plant), np.repeat(u, 5))[::5], abs=1e-12
    )
    assert over_path(plant, AT_ONCE) is plant


def test_broken_at_the_set_point_or_at_the_sensor_is_the_same():
    """L at the set-point: the compensator's transfer from sensor to set-point, by itself, times the plant's."""
    settings, gains, _ = designed(2)
    plant = model_system(settings.model, PERIOD_S)
    omega = np.geomspace(10.0, 3e4, 40)
    one = np.eye(len(gains.A))
    correct, F = one - np.outer(gains.observer, gains.C), gains.A - np.outer(gains.B, gains.feedback)
    compensator = []
    for z in np.exp(1j * omega * PERIOD_S):
        # estimate after its correction: x = (I - L C) F x / z + L y
        x = np.linalg.solve(one - correct @ F / z, gains.observer.astype(complex))
        compensator.append(gains.feedback @ x)
    expected = np.array(compensator) * plant.response(omega)
    assert stage_loop(gains, plant).response(omega) == pytest.approx(expected, rel=1e-7)


def test_a_plant_that_feeds_through_is_refused():
    _, gains, _ = designed(2)
    with pytest.raises(ValueError, match="must not feed through"):
        stage_loop(gains, delay(0.0, PERIOD_S))
