"""The preview beside the truth: drawn paths, played; what the tracker saw in a recording as a path."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.analyse.budget.path_record import followed_share
from micromanip.design.analyse.path.prediction import inverse_voltage, predict
from micromanip.design.analyse.path.preview import (
    RANGE,
    RESERVE,
    Demand,
    Stretch,
    beyond,
    laws_on_path,
    stretches,
)
from micromanip.design.analyse.path.seen import recorded_path
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS
from micromanip.rt.laws.hysteresis import model_output
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import DEVIATION_FRESH
from micromanip.settings.check import prepare
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.reference import Oscillation

from .played_path import ABOUT_S, hard_stretches, narrowed

PATH_HZ = 2000.0


@pytest.fixture(scope="module")
def cell():
    """Laws and tracking of axis x."""
    return laws_on_path(prepare(CONFIG / "simulated.yaml"), "x")


def with_joint(cell, range_percent):
    """Tracking of x by a predictor that knows of one joint, and follows its frequency so far."""
    joints = (Oscillation(frequency_Hz=8.0, um_per_s=3.2, range_percent=range_percent),)
    return replace(cell[1], tracker=replace(cell[1].tracker, oscillations=joints, steady=None))


@pytest.mark.parametrize("hertz", [3.0, 25.0])
def test_a_sine_comes_through_as_the_closed_loop_says(cell, hertz):
    time_s = np.arange(6000) / PATH_HZ
    laws, tracking = cell[0], with_joint(cell, 0.0)
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
        found_of[percent] = np.std(predict(cell[0], tracking, 0.0, path, PATH_HZ).error_um[2000:4000])
    known = replace(tracking.tracker, oscillations=(Oscillation(frequency_Hz=hertz, um_per_s=3.2),))
    omega = np.array([2.0 * np.pi * hertz])
    laws = replace(cell[0], tracker=known)
    loop = laws.around(laws.model(omega), omega)
    left = 1.0 - followed_share(loop, replace(tracking, tracker=known), laws.gains.reference)
    assert found_of[50.0] == pytest.approx(20.0 * abs(left[0]) / np.sqrt(2.0), rel=0.2, abs=0.01)
    assert found_of[0.0] > 5.0 * found_of[50.0]


def test_the_voltage_gives_the_set_point_back_through_the_model(cell):
    axis = cell[0].axis
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
    axis = cell[0].axis
    pid = axis.model_copy(update={"inner": axis.inner.model_copy(update={"mode": "pid"})})
    assert inverse_voltage(pid, 0.0, np.zeros(3), PATH_HZ) is None


RATE_HZ = 1000.0
TIME_S = np.arange(2000) / RATE_HZ


def test_a_stretch_is_where_the_limit_is_crossed_and_by_how_much():
    ramps = Demand(RANGE, "um", 100.0 * np.abs(TIME_S - 1.0) - 50.0, -30.0, 30.0)  # beyond: to .2, .8 to 1.2, from 1.8
    first, middle, last = stretches("x", ramps, RATE_HZ)
    assert (first.from_s, first.asked, first.limit, first.over) == (0.0, 50.0, 30.0, 20.0)
    assert first.to_s == pytest.approx(0.2, abs=2e-3)
    assert (middle.from_s, middle.to_s) == pytest.approx((0.8, 1.2), abs=2e-3)
    assert (middle.asked, middle.limit, middle.over) == (-50.0, -30.0, 20.0)
    assert (last.from_s, last.to_s) == pytest.approx((1.8, 2.0), abs=2e-3)


def test_a_reserve_is_told_where_it_leads_to_no_more():
    def of(what, from_s, to_s):
        return Stretch("x", what, from_s, to_s, 1.0, 0.0, 1.0, "um")

    hard, around = of(RANGE, 1.0, 2.0), of(RESERVE, 0.98, 2.1)
    before, alone = of(RESERVE, 0.7, 2.1), of(RESERVE, 3.0, 3.5)
    assert beyond([hard, around, before, alone]) == [hard, before, alone]


@pytest.mark.long
def test_on_a_path_that_fits_no_limit_is_met(tmp_path):
    over, _, met_s = hard_stretches(prepare(CONFIG / "simulated.yaml"), 2, tmp_path)
    assert not over
    assert not len(met_s)


@pytest.mark.long
def test_the_first_limit_is_met_where_the_verdict_says(tmp_path):
    over, (first, *_), met_s = hard_stretches(narrowed(prepare(CONFIG / "simulated.yaml")), 9, tmp_path)
    assert ((met_s >= first.from_s - ABOUT_S) & (met_s <= first.to_s + ABOUT_S)).any()
    assert met_s[0] >= first.from_s - ABOUT_S or any(each.from_s < first.from_s for each in over)


@dataclass
class Recorded:
    """As much of a recording as a path takes of it."""

    values: dict
    axes: tuple = ("x", "y")
    file: Path = Path("run.mcap")

    def column(self, path):
        return self.values[path]

    def columns(self, *paths):
        return {path: self.values[path] for path in paths}


def recording(cycles=4000, every=10, age_ns=1_000_000):
    """10 kHz rows of a tracker that is fresh in each tenth, 1 ms late."""
    at = np.arange(cycles)
    fresh = np.where(at % every == 3, DEVIATION_FRESH, 0)
    taken_s = (at - (at - 3) % every) * 1e-4 - 1e-9 * age_ns
    columns = {"time_ns": 7_000_000_000 + at * 100_000, "state": np.full(cycles, TRACKING)}
    for k, hertz in enumerate((1.0, 2.0)):
        columns |= {
            f"axis.{k}.fresh": fresh | 1,
            f"axis.{k}.deviation_age_ns": np.full(cycles, float(age_ns)),
            f"axis.{k}.deviation_um": 100.0 * np.sin(2.0 * np.pi * hertz * taken_s),
        }
    return Recorded(columns)


def test_what_the_tracker_saw_counts_when_it_was_taken():
    path = recorded_path(recording(), ["y", "x"])
    assert path.even_step_s() == pytest.approx(1e-3)
    first_s = 3e-4 - 1e-3
    for column, hertz in zip(path.deviation_um.T, (2.0, 1.0), strict=True):
        np.testing.assert_allclose(column, 100.0 * np.sin(2.0 * np.pi * hertz * (path.time_s + first_s)), atol=1e-6)
