"""The actuator's dynamics, from a recording of the simulated cell: beside the physics that made it."""

import numpy as np
import pytest
from micromanip_drivers.simulated import mechanics
from micromanip_drivers.simulated.options import Plant

from campaigns.report import CONFIG
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.design.identify.actuation import identify_actuator, working_voltage
from micromanip.errors import CheckFailed
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

SIMULATED = CONFIG / "simulated.yaml"


@pytest.fixture(scope="module")
def prepared():
    return prepare(SIMULATED)


@pytest.fixture(scope="module")
def actuator(prepared):
    return identify_actuator(prepared.configuration, VirtualExperiment(prepared), "x")


def physics(hertz):
    """Strain over voltage of the linear parts, with static gain 1: amplifier, mechanics, gauge."""
    A, B = mechanics.continuous(Plant())
    s = 2j * np.pi * np.asarray(hertz)
    mechanical = np.array([np.linalg.solve(value * np.eye(5) - A, B[:, 0])[4] for value in s])
    return mechanical / np.linalg.solve(-A, B[:, 0])[4] / (1.0 + s / (2 * np.pi * 900.0))


@pytest.mark.long
def test_it_is_the_physics(actuator):
    """Size within 10 % from 10 Hz to the mode near 2.4 kHz, the flexure's mode and antiresonance included."""
    hertz = np.array([10.0, 30.0, 55.0, 60.0, 63.0, 65.0, 67.0, 70.0, 100.0, 300.0, 1000.0, 2000.0, 2350.0])
    found = np.abs(actuator.system.response(2 * np.pi * hertz))
    ratio = found / np.abs(physics(hertz))
    assert ratio / np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert actuator.found.fit_percent > 80.0


def test_its_slope_is_that_of_the_describing_function(prepared, actuator):
    """The hysteresis model was fitted to quite another experiment."""
    axis = prepared.configuration.axes["x"]
    slope = 1.0 / abs(harmonics(inverse_operator(axis.hysteresis), actuator.swing_um, axis.centre_um).gain)
    assert abs(actuator.system.response(np.array([2 * np.pi * 10.0]))[0]) == pytest.approx(slope, rel=0.05)


def test_the_working_voltage_holds_the_working_point(prepared, actuator):
    volts = working_voltage(prepared.configuration, VirtualExperiment(prepared), "x")
    assert volts == pytest.approx(actuator.centre_V, abs=1.0)
    assert 60.0 < volts < 95.0


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        pytest.param(
            lambda strain: np.random.default_rng(0).normal(size=len(strain)),
            "nothing of the response stands out of its noise in 2 attempts",
            marks=pytest.mark.thorough,  # two whole experiments
        ),
        (lambda strain: np.zeros(len(strain)), "stands still"),
        (lambda strain: np.where(np.arange(len(strain)) == 5, np.nan, strain), "has gaps"),
    ],
)
def test_useless_records_are_refused(prepared, spoil, said):
    """And nothing but open loops is played for it."""
    experiment = VirtualExperiment(prepared)

    class Spoilt:
        def __init__(self):
            self.modes = set()

        def __call__(self, configuration, seconds, samples=None, every=1):
            self.modes.update(axis.mode for axis in configuration.axes.values())
            rows = experiment(configuration, seconds, samples, every)
            rows["axis"]["strain_um"][:, 0] = spoil(rows["axis"]["strain_um"][:, 0])
            return rows

        def path(self, configuration, axis):
            return experiment.path(configuration, axis)

    spoilt = Spoilt()
    with pytest.raises(CheckFailed, match=said):
        identify_actuator(prepared.configuration, spoilt, "x", centre_V=75.0)
    assert spoilt.modes == {"voltage"}
