"""Both loops as systems: they are what runs, and their margins are those of the design table."""

from pathlib import Path

import numpy as np
import pytest
from rt.builders import PERIOD_S, record
from rt.outer_loops import designed

from micromanip.control.margins import margins
from micromanip.control.outer_gains import outer_gains
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import System, delay
from micromanip.design.analyse.loops import StrainSide, held_plant, over_path, strain_loop
from micromanip.rt.laws.pid import PID_PARAMETERS, PID_STATE, pid_output
from micromanip.settings.load import load_with_source
from micromanip.settings.schema.axis import Inner, LinearModel
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

CONFIG = Path(__file__).parents[3] / "config" / "paper.yaml"
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


def test_strain_loop_is_the_product():
    plant = System(np.array([[0.7]]), np.array([0.3]), np.array([0.6]), 0.0, PERIOD_S)
    omega = np.geomspace(10.0, 3e4, 30)
    z = np.exp(1j * omega * PERIOD_S)
    K, Ti, Td, Tf = PID.K_V_per_um, PID.Ti_ms * 1e-3, PID.Td_ms * 1e-3, PID.filter_ms * 1e-3
    difference = 1.0 - 1.0 / z
    pid = K + K * PERIOD_S / (Ti * difference) + K * Td * difference / (Tf * difference + PERIOD_S)
    expected = 1.3 * pid * 0.18 / (z - 0.7)
    assert strain_loop(PID, plant, 1.3).response(omega) == pytest.approx(expected, rel=1e-10)


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


# Ms, dB, degrees of three designs that were tried on the simulated plant. Their plant was another order-6 model of the
# same cell, identified from another recording: models of this order differ by some per cent from 500 Hz on, where
# the sensitivity peaks, so Ms is asserted to 12 % and the margins to 1.7 dB and 4 degrees. Axis y has the model that is
# nearest to the plant there.
TABLE = [
    ({"control_weight": 30.0, "disturbance_um": 0.03, "oscillation_Hz": None}, 1.67, 9.8, 49.0),
    ({"control_weight": 10.0, "disturbance_um": 0.1, "oscillation_Hz": 200.0, "oscillation_um": 1e-3}, 1.87, 7.5, 45.0),
    ({"control_weight": 3.0, "disturbance_um": 0.3, "oscillation_Hz": 200.0, "oscillation_um": 2e-3}, 2.06, 5.9, 42.0),
]


@pytest.fixture(scope="module")
def outer():
    return load_with_source(CONFIG)[0].axes["y"].outer


def found_margins(outer, options, extra_delay=0.0):
    settings = outer.model_copy(update=options)
    gains = outer_gains(settings, None, PERIOD_S)
    return margins(stage_loop(gains, model_system(settings.model, PERIOD_S, extra_delay)))


@pytest.mark.parametrize(("options", "Ms", "gain_dB", "phase_deg"), TABLE)
def test_margins_of_the_designs_that_were_tried(outer, options, Ms, gain_dB, phase_deg):
    found = found_margins(outer, options)
    assert found.stable
    assert found.sensitivity == pytest.approx(Ms, rel=0.12)
    assert found.gain_dB == pytest.approx(gain_dB, abs=1.7)
    assert found.phase_deg == pytest.approx(phase_deg, abs=4.0)


def test_a_plant_that_feeds_through_is_refused():
    _, gains, _ = designed(2)
    with pytest.raises(ValueError, match="must not feed through"):
        stage_loop(gains, delay(0.0, PERIOD_S))
