"""Figures of a response against closed forms: a second-order step, a sine through a known lag."""

import numpy as np
import pytest

from micromanip.gateway.response import sine_figures, step_figures

T_S = np.arange(20_000) * 1e-4
DAMPING, OMEGA = 0.4, 60.0


def second_order():
    damped = OMEGA * np.sqrt(1.0 - DAMPING**2)
    ringing = np.cos(damped * T_S) + DAMPING / np.sqrt(1.0 - DAMPING**2) * np.sin(damped * T_S)
    return 1.0 - np.exp(-DAMPING * OMEGA * T_S) * ringing


@pytest.mark.parametrize("by_um", [7.0, -3.0])
def test_a_second_order_step_has_the_overshoot_of_the_book(by_um):
    found = step_figures(T_S, 40.0 + by_um * second_order(), by_um)
    assert found["overshoot_percent"] == pytest.approx(
        100.0 * np.exp(-np.pi * DAMPING / np.sqrt(1 - DAMPING**2)), rel=1e-3
    )
    assert found["rise_s"] == pytest.approx(1.46 / OMEGA, rel=0.02), "1.46 / omega at a damping of 0.4"
    outside = np.abs(second_order() - 1.0) > 0.02
    assert found["settling_s"] == pytest.approx(T_S[np.flatnonzero(outside)[-1] + 1])


def test_what_does_not_get_there_has_no_rise_and_does_not_settle():
    found = step_figures(T_S, 0.5 * second_order(), 1.0)
    assert (found["overshoot_percent"], found["rise_s"], found["settling_s"]) == (0.0, None, None)


@pytest.mark.parametrize("hertz", [2.0, 9.5])
def test_gain_and_lag_of_a_sine_are_those_of_the_lag_it_came_through(hertz):
    wanted = 3.0 + 5.0 * np.sin(2 * np.pi * hertz * T_S + 0.3)
    found = 50.0 + 0.8 * 5.0 * np.sin(2 * np.pi * hertz * T_S + 0.3 - np.radians(35.0))
    got = sine_figures(T_S, wanted, found, hertz)
    assert got["gain"] == pytest.approx(0.8, rel=1e-6)
    assert got["lag_deg"] == pytest.approx(35.0, abs=1e-4)
