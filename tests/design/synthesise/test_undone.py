"""What the feedforward of mode strain undoes, found from a plant whose own equations are known."""

import numpy as np
import pytest
from micromanip_drivers.simulated.mechanics import continuous
from micromanip_drivers.simulated.options import Plant, SecondMode
from scipy.linalg import expm

from micromanip.control.system import System, delay
from micromanip.design.synthesise.actuator import invert_actuator, resonances
from micromanip.design.synthesise.pid import PidDesign
from micromanip.settings.schema.axis import Inner

PERIOD_S, GAUGE_US, LAG_US = 1e-4, 1e6 / (2 * np.pi * 2500.0), 1e6 / (2 * np.pi * 900.0)
INNER = Inner(mode="pid+feedforward", K_V_per_um=0.2817, Ti_ms=0.105, Td_ms=0.05807, filter_ms=0.01786)
ASKED_HZ = (1.0, 5.0, 10.0)


def true_dynamics(plant, um_per_V=0.65):
    """Voltage, held, by the amplifier's lag, the masses and the gauge to its reading; exact."""
    a, b = continuous(plant)
    n, lag_s = len(a), 1e-6 * LAG_US
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n] = a, um_per_V * b[:, 0]
    block[n, n], block[n, n + 1] = -1.0 / lag_s, 1.0 / lag_s
    moved = expm(block * PERIOD_S)
    C = np.zeros(n + 1)
    C[4] = 1.0
    return System(moved[: n + 1, : n + 1], moved[: n + 1, n + 1], C, 0.0, PERIOD_S)


def swings(matrix):
    """Frequency (Hz) and damping ratio of its oscillating eigenvalues, the slowest first."""
    rates = np.linalg.eigvals(matrix)
    return sorted((abs(s) / (2 * np.pi), -s.real / abs(s)) for s in rates if s.imag > 1.0)


def undone(plant, noise_um=0.055, left_um=0.4):
    """It takes the loop a cycle to hand a voltage over."""
    return invert_actuator(true_dynamics(plant), 1, INNER, GAUGE_US, noise_um, left_um, ASKED_HZ)


@pytest.mark.parametrize("plant", [Plant(), Plant(stage_kg=20.0, damping=0.01), Plant(flexure_N_per_um=4.0)])
def test_a_resonance_is_that_of_the_masses_and_its_antiresonance_that_of_the_stage_alone(plant):
    (found,) = resonances(true_dynamics(plant))
    a, _ = continuous(plant)
    assert (found.resonance_Hz, found.resonance_damping) == pytest.approx(swings(a[:4, :4])[0], rel=1e-3)
    held = swings(a[2:4, 2:4])[0]  # the actuator held: the stage on its flexure
    assert (found.antiresonance_Hz, found.antiresonance_damping) == pytest.approx(held, rel=1e-3)


def test_each_thing_that_is_undone_is_worth_it_also_where_the_model_is_wrong():
    found = undone(Plant())
    assert found.taken == ("delay", "resonances", "lag")
    for before, after in zip(["nothing", *found.taken], found.taken, strict=False):
        assert found.tried[after][0] < found.tried[before][0]
        assert found.tried[after][1] <= found.tried[before][1]
    assert found.tried["lag"][0] < 0.2 * found.tried["nothing"][0]


@pytest.mark.parametrize(("noise_um", "left_um", "percent"), [(1e-4, 1.0, 100.0), (0.1, 1e-4, 60.0)])
def test_the_pid_is_left_what_it_is_needed_for(noise_um, left_um, percent):
    assert undone(Plant(), noise_um, left_um).actuator.feedback_percent == percent


def test_less_feedback_is_taken_only_where_the_loop_bears_it():
    """Of this plant (seed 273) the crossover comes down from 230 Hz to its mode at 77 Hz: 38 degrees become 14."""
    mode = SecondMode(ratio=3.25, stiffness_share=0.38, gain=-0.1)
    masses = {"piezo_N_per_um": 497.0, "actuator_kg": 2.417, "stage_kg": 11.32}
    plant = Plant(flexure_N_per_um=2.528, guide_N_per_um=0.1496, damping=0.0383, second_mode=mode, **masses)
    dynamics = true_dynamics(plant, 0.519)
    inner = INNER.model_copy(update={"K_V_per_um": 0.2443, "Ti_ms": 0.06069, "Td_ms": 0.0, "filter_ms": 0.2905})
    slopes, late = (0.75, 1.0, 1.373), delay(1, PERIOD_S).then(dynamics)
    design = PidDesign(inner, slopes, (), noise_gain=1.0, residual_10Hz=0.1, limited_by="")
    assert design.bears(1.0, late, 6.0, 30.0)
    assert not design.bears(0.6, late, 6.0, 30.0)

    def percent(bears):
        return invert_actuator(dynamics, 1, inner, GAUGE_US, 0.1, 1e-4, ASKED_HZ, bears).actuator.feedback_percent

    assert percent(lambda share: True) == 60.0
    assert percent(lambda share: design.bears(share, late, 6.0, 30.0)) == 90.0
    assert percent(lambda share: False) == 100.0
