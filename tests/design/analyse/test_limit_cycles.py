"""Limit cycles against textbook cases that have a closed form."""

import numpy as np
import pytest

from micromanip.design.analyse.describing import limit_cycles

OMEGA = np.geomspace(0.01, 100.0, 400)
AMPLITUDES = np.geomspace(0.01, 10.0, 200)


def third_order(omega):
    s = 1j * np.asarray(omega)
    return 1.0 / (s * (s + 1.0) * (s + 2.0))


def relay(amplitude, height=1.0):
    return 4.0 * height / (np.pi * amplitude) + 0j


def test_relay_on_an_integrator_with_two_lags():
    """L crosses the negative axis at sqrt 2 with 1/6: A = 4 / (6 pi)."""
    (cycle,) = limit_cycles(relay, AMPLITUDES, third_order, OMEGA)
    assert cycle.amplitude == pytest.approx(4.0 / (6.0 * np.pi), rel=1e-8)
    assert cycle.frequency_Hz == pytest.approx(np.sqrt(2.0) / (2 * np.pi), rel=1e-8)
    assert cycle.residual < 1e-8


def test_relay_with_hysteresis_on_an_integrator_with_a_lag():
    """N = 4/(pi A^2) (sqrt(A^2 - d^2) - i d): solved for A and w by hand on L = 1/(s (s + 1))."""
    width = 0.1

    def element(amplitude):
        if amplitude <= width:
            return complex(np.nan, np.nan)
        return 4.0 / (np.pi * amplitude**2) * complex(np.sqrt(amplitude**2 - width**2), -width)

    (cycle,) = limit_cycles(element, AMPLITUDES, lambda w: 1.0 / (1j * w * (1j * w + 1.0)), OMEGA)
    # -1/N = -(pi/4)(sqrt(A^2 - d^2) + i d); L = -(1 + i/w)/(1 + w^2)
    omega = 2 * np.pi * cycle.frequency_Hz
    assert 1.0 / (omega * (1.0 + omega**2)) == pytest.approx(np.pi * width / 4.0, rel=1e-7)
    assert np.sqrt(cycle.amplitude**2 - width**2) == pytest.approx(4.0 / np.pi / (1.0 + omega**2), rel=1e-7)


def test_saturation_below_the_critical_gain_has_none_and_above_it_has_one():
    def saturation(amplitude):
        if amplitude <= 1.0:
            return 1.0 + 0j
        return complex(2.0 / np.pi * (np.arcsin(1.0 / amplitude) + np.sqrt(1.0 - amplitude**-2) / amplitude))

    assert limit_cycles(saturation, AMPLITUDES, lambda w: 5.0 * third_order(w), OMEGA) == []
    (cycle,) = limit_cycles(saturation, AMPLITUDES, lambda w: 12.0 * third_order(w), OMEGA)
    assert saturation(cycle.amplitude).real == pytest.approx(0.5, rel=1e-8)
