"""The prediction of a path: standing, swinging, in part; its voltage through the model that it inverts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.analyse.budget.causes import followed_share
from micromanip.design.analyse.path.prediction import inverse_voltage, predict
from micromanip.design.analyse.path.preview import cell_of
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS
from micromanip.rt.laws.hysteresis import model_output
from micromanip.settings.check import prepare
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.reference import Oscillation

CONFIG = Path(__file__).parents[4] / "config"
PATH_HZ = 2000.0


@pytest.fixture(scope="module")
def cell():
    return cell_of(prepare(CONFIG / "simulated.yaml"), ["x"])


def with_joint(cell, range_percent):
    """Tracking of x by a predictor that knows of one joint, and follows its frequency so far."""
    joints = (Oscillation(frequency_Hz=8.0, um_per_s=3.2, range_percent=range_percent),)
    tracker = replace(cell.tracking["x"].tracker, oscillations=joints, steady=None)
    return replace(cell.tracking["x"], tracker=tracker)


@pytest.mark.parametrize("hertz", [3.0, 25.0])
def test_a_sine_comes_through_as_the_closed_loop_says(cell, hertz):
    time_s = np.arange(6000) / PATH_HZ
    laws, tracking = cell.laws["x"], with_joint(cell, 0.0)
    found = predict(laws, tracking, 0.0, 20.0 * np.sin(2.0 * np.pi * hertz * time_s), PATH_HZ)
    omega = np.array([2.0 * np.pi * hertz])
    loop = laws.around(laws.model(omega), omega)
    given = followed_share(loop, tracking, laws.gains.reference) / loop.followed
    middle = slice(2000, 4000)  # whole periods, far from both ends
    turned = np.exp(-1j * omega * time_s[middle])
    for values, response in (
        (found.setpoint_um - laws.axis.centre_um, loop.following * loop.sensitivity * given),
        (found.error_um, 1.0 - loop.followed * given),
    ):
        assert 2j * np.mean(values[middle] * turned) == pytest.approx(20.0 * response[0], rel=1e-3, abs=2e-3)


@pytest.mark.parametrize("hertz", [6.5, 9.5])
def test_a_joint_that_swings_at_another_frequency_is_followed_as_the_loop_follows_it(cell, hertz):
    """Left is what a predictor would leave that knew it; one whose frequency is fixed leaves ten times that."""
    found_of = {}
    for percent in (0.0, 50.0):
        tracking = with_joint(cell, percent)
        path = 20.0 * np.sin(2.0 * np.pi * hertz * np.arange(6000) / PATH_HZ)
        found_of[percent] = np.std(predict(cell.laws["x"], tracking, 0.0, path, PATH_HZ).error_um[2000:4000])
    known = tracking.tracker.at_swings([hertz])
    omega = np.array([2.0 * np.pi * hertz])
    laws = replace(cell.laws["x"], tracker=known)
    loop = laws.around(laws.model(omega), omega)
    left = 1.0 - followed_share(loop, replace(tracking, tracker=known), laws.gains.reference)
    assert found_of[50.0] == pytest.approx(20.0 * abs(left[0]) / np.sqrt(2.0), rel=0.2, abs=0.01)
    assert found_of[0.0] > 5.0 * found_of[50.0]


def test_the_voltage_gives_the_set_point_back_through_the_model(cell):
    axis = cell.laws["x"].axis
    time_s = np.arange(2000) / PATH_HZ
    wanted = 66.0 + 55.0 * np.sin(2.0 * np.pi * 2.0 * time_s) * np.exp(-time_s)
    voltage = inverse_voltage(axis, 0.0, wanted, PATH_HZ)
    h = np.zeros(1, HYSTERESIS_PARAMETERS)[0]
    fill_hysteresis(h, axis.hysteresis, 1.0 / PATH_HZ)
    memory = np.zeros(len(h["r"]))
    given = np.array([model_output(h, memory, volts) for volts in voltage])
    # whatever the model remembered before is wiped out by the first full swing
    np.testing.assert_allclose(given[500:], wanted[500:], atol=1e-6)


def test_without_an_inverse_no_voltage_is_claimed(cell):
    axis = cell.laws["x"].axis
    pid = axis.model_copy(update={"inner": axis.inner.model_copy(update={"mode": "pid"})})
    assert inverse_voltage(pid, 0.0, np.zeros(3), PATH_HZ) is None
