"""The strain loop is judged with the PID that runs, not with the one that is written."""

from types import SimpleNamespace

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.control.margins import margins
from micromanip.control.system import System
from micromanip.design.analyse.axis import analyse_axis
from micromanip.design.analyse.loop_analysis import SLOPES, analyse_inverse, analyse_strain, slopes_of, small_slope
from micromanip.design.analyse.loops import strain_loop
from micromanip.design.experiment import with_axis
from micromanip.settings.load import load
from micromanip.settings.schema.axis import Axis
from micromanip.settings.wiring.timing import AT_ONCE

PLANT = System(np.array([[0.8, 0.0], [0.13, 0.8]]), np.array([0.13, 0.0]), np.array([0.0, 1.0]), 0.0, 1e-4)

SEEN = SimpleNamespace(
    system=PLANT, dynamics=PLANT, delay=0, path=AT_ONCE, swing_um=20.0, centre_V=60.0, branch_um_per_V=0.0
)


def axis(mode, weight=0.08):
    return Axis.model_validate(
        {
            "mode": mode,
            "centre_um": 60.0,
            "setpoint": {"range_um": [2.0, 128.0], "slew_um_per_ms": 30.0},
            "hysteresis": {"model": "pi", "range_um": [2, 128], "thresholds_um": [3.5], "weights": [weight]}
            | {"shaping": "affine", "coefficients": [0.63, 0.0]},
            "inner": {"mode": "pid+feedforward", "K_V_per_um": 0.4, "Ti_ms": 0.3, "Td_ms": 0.05, "filter_ms": 0.02},
            "actuator": {"delay_us": 190.0, "feedback_percent": 80.0},
            "outer": None,
        }
    )


def test_the_share_of_the_feedback_that_is_left_is_what_is_judged():
    running = axis("strain")
    found = analyse_strain(running, SEEN, None)
    weaker = running.inner.model_copy(update={"K_V_per_um": 0.8 * running.inner.K_V_per_um})
    for slope, judged in zip(found.slopes, found.margins, strict=True):
        assert judged.sensitivity == pytest.approx(margins(strain_loop(weaker, PLANT, slope)).sensitivity)
        whole = margins(strain_loop(running.inner, PLANT, slope))
        assert judged.sensitivity != pytest.approx(whole.sensitivity, rel=1e-3)
    assert found.side.inner == weaker


def test_an_outer_loop_has_the_whole_feedback_inside_also_while_the_axis_is_in_mode_strain():
    tuned = load(CONFIG / "simulated.yaml")
    configuration = with_axis(tuned, "x", mode="strain", actuator=axis("strain").actuator)
    found = analyse_axis(configuration, "x", None, range(0), actuator=SEEN)
    assert found.strain.side.inner == configuration.axes["x"].inner


class TestSlopes:
    """One play of weight 1.5 behind .63 um/V: .63 for a swing within its threshold, towards 2.5 times that beyond."""

    SWING_UM = 0.5

    def slopes(self, seen_um_per_V):
        running = axis("strain", weight=1.5)
        return slopes_of(running, self.SWING_UM, analyse_inverse(running.hysteresis, running), seen_um_per_V)

    def test_without_more_in_the_response_they_are_those_of_the_map(self):
        identified, (flattest, *within, steepest) = self.slopes(0.63)
        assert identified == pytest.approx(0.63, rel=1e-6)
        assert 1.0 in within
        neighbours = np.array([flattest, *within, steepest])
        assert np.all(np.diff(neighbours) > 0.0)
        assert np.all(neighbours[1:] / neighbours[:-1] < 1.36), "a margin may be least within the range"
        assert flattest <= SLOPES[0]
        assert steepest == pytest.approx(2.5, rel=1e-3), "along a branch the play moves, too"
        # a response that shows less takes nothing away
        assert self.slopes(0.3)[1] == pytest.approx(neighbours)

    def test_the_steepest_is_a_multiple_of_the_slope_that_was_seen(self):
        """What the margins hold for stays the same in um/V: the map's steepest, but for the reserve of 1.15."""
        mapped, (flattest, *_, widest) = self.slopes(0.0)
        _, (same, *_, steepest) = self.slopes(1.5 * mapped)
        assert steepest * 1.5 * mapped / 1.15 == pytest.approx(widest * mapped)
        assert same == flattest

    @pytest.mark.parametrize("seen_um_per_V", [0.0, 0.63, 1.0, 5.0])
    def test_they_are_never_narrower_than_those_of_every_actuator(self, seen_um_per_V):
        _, (flattest, *_, steepest) = self.slopes(seen_um_per_V)
        assert flattest <= SLOPES[0]
        assert steepest >= SLOPES[-1]

    def test_a_response_shows_the_slope_of_a_small_swing(self):
        z = np.exp(2j * np.pi * 20.0 * 1e-4)
        assert small_slope(PLANT) == pytest.approx(abs(0.13 * 0.13 / (z - 0.8) ** 2))
