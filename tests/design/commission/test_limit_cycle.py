"""A swing that a loop keeps alive, told from the noise of its sensor and of what it passes on."""

import numpy as np
import pytest

from micromanip.design.commission.limit_cycle import Seen, compared

RATE_HZ = 10_000.0
T_S = np.arange(10_000) / RATE_HZ


def noise(seed, um=0.05):
    return np.random.default_rng(seed).normal(0.0, um, len(T_S))


def rest(still, closed):
    return compared(Seen.of(still), Seen.of(closed), RATE_HZ)


@pytest.mark.parametrize("hertz", [7.0, 38.0, 412.0])
def test_a_line_that_is_not_there_without_the_loop_is_a_swing(hertz):
    line = 0.2 * np.sin(2 * np.pi * hertz * T_S)
    found = rest(noise(1), noise(2) + line)
    assert found.swings
    assert found.line_Hz == pytest.approx(hertz, abs=1.0)
    assert not rest(noise(1) + line, noise(2) + line).swings, "hum is there in any case"
    assert found.floor_um < 0.06, "what the loop itself adds excuses nothing"


def test_noise_a_little_louder_and_a_slow_drift_are_none():
    assert not rest(noise(1), noise(2, 0.07) + 0.4 * T_S).swings
    assert rest(noise(1), np.cumsum(noise(2, 0.05))).swings, "many times as loud, though it has no line"


def test_a_coarse_gauge_may_be_hunted_by_one_of_its_steps():
    """With the output held it says the same for ever."""
    still, hunted = np.full(len(T_S), 3.0), 3.0 + 0.4 * (np.sin(2 * np.pi * 5.0 * T_S) > 0.0)
    assert not rest(still, hunted).swings
    assert rest(still, 3.0 + 0.4 * np.round(4.0 * np.sin(2 * np.pi * 5.0 * T_S))).swings


def test_a_sensor_that_is_not_there_says_nothing():
    assert not len(Seen.of(np.full(100, np.nan)).moved_um)
