"""Filters over a whole part beside those of scipy and of python-control."""

from functools import partial

import control
import numpy as np
import pytest
from scipy import signal

from micromanip.design.learning.zero_phase import ORDER, answered, filtered, low_pass

RATE_HZ = 1000.0
RNG = np.random.default_rng(5)


def test_the_low_pass_is_a_butterworth_filter_run_forwards_and_backwards():
    x, corner_hz = RNG.normal(size=6000), 25.0
    half = signal.butter(ORDER // 2, corner_hz, fs=RATE_HZ, output="sos")
    expected = signal.sosfiltfilt(half, x)
    found = filtered(x, RATE_HZ, partial(low_pass, corner_hz=corner_hz))
    inside = slice(500, -500)
    assert found[inside] == pytest.approx(expected[inside], abs=0.01 * expected.std())


def test_it_has_no_lag_and_keeps_what_is_constant():
    t = np.arange(4000) / RATE_HZ
    x = 2.0 + np.sin(2 * np.pi * 5.0 * t)
    assert filtered(x, RATE_HZ, partial(low_pass, corner_hz=50.0))[500:-500] == pytest.approx(x[500:-500], abs=1e-3)


@pytest.fixture
def lightly_damped():
    """A resonance at 60 Hz behind two samples, with a zero outside of the unit circle: its inverse is not stable."""
    poles = np.exp(2 * np.pi * 60.0 / RATE_HZ * np.array([-0.1 + 1j, -0.1 - 1j]))
    numerator = np.array([1.0, -1.6])
    numerator *= np.poly(poles).sum() / numerator.sum()
    return control.tf(np.append(np.zeros(2), numerator), np.append(np.poly(poles).real, [0.0]), 1.0 / RATE_HZ)


def response_of(system):
    return lambda hertz: np.atleast_1d(np.squeeze(system(np.exp(2j * np.pi * hertz / RATE_HZ))))


def test_an_answer_is_that_of_the_system_from_rest(lightly_damped):
    x = RNG.normal(size=3000)
    _, expected = control.forced_response(lightly_damped, np.arange(len(x)) / RATE_HZ, x)
    found = answered(x, RATE_HZ, response_of(lightly_damped))
    assert found == pytest.approx(expected, abs=1e-4 * expected.std())


def test_the_inverse_of_what_has_no_stable_inverse_undoes_it(lightly_damped):
    t = np.arange(8000) / RATE_HZ
    wanted = np.exp(-(((t - 4.0) / 1.0) ** 4)) * np.sin(2 * np.pi * 8.0 * t)
    way = response_of(lightly_damped)
    given = filtered(wanted, RATE_HZ, lambda hertz: low_pass(hertz, 50.0) / way(hertz))
    assert np.abs(given).max() < 10.0
    assert np.abs(given - wanted).max() > 0.05, "it is not its own inverse"
    assert answered(given, RATE_HZ, way) == pytest.approx(wanted, abs=1e-3)
