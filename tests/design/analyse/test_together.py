"""Loops as one: relative gains, and the Perron bound, beside closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.design.analyse.coupling import judge_together, relative_gain

HERTZ = np.geomspace(0.1, 1000.0, 600)
S = 2j * np.pi * HERTZ


def integrators(*crossovers_Hz, late_s=0.0):
    return np.array([2 * np.pi * hertz / S * np.exp(-late_s * S) for hertz in crossovers_Hz])


def constant(matrix):
    return np.repeat(np.array(matrix, dtype=complex)[:, :, None], len(HERTZ), axis=2)


def test_relative_gain_of_two_axes_is_the_textbooks():
    a, b = 0.3, -0.2
    gains = relative_gain(np.array([[1.0, a], [b, 1.0]])).real
    own = 1.0 / (1.0 - a * b)
    assert gains == pytest.approx(np.array([[own, 1 - own], [1 - own, own]]))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6), st.lists(st.floats(0.2, 5.0), min_size=3, max_size=3))
def test_rows_and_columns_of_relative_gains_are_one_whatever_the_inputs_gains(shares, gains):
    matrix = np.eye(3)
    matrix[~np.eye(3, dtype=bool)] = shares
    if abs(np.linalg.det(matrix)) < 0.1:
        return
    found = relative_gain(matrix).real
    assert found.sum(axis=0) == pytest.approx(np.ones(3))
    assert found.sum(axis=1) == pytest.approx(np.ones(3))
    assert relative_gain(matrix * gains).real == pytest.approx(found)


def test_two_integrators_that_help_each_other_turn_where_the_closed_form_says():
    """L = [[1, c], [c, 1]] l has the loops (1 + c) l and (1 - c) l: with a delay these are stable up to pi/2 in w T."""
    late_s, crossover = 1e-3, 200.0  # 2 pi 200 1e-3 = 1.257 of 1.571: stable alone by a factor of 1.25
    loops = integrators(crossover, crossover, late_s=late_s)
    for share, stable in ((0.1, True), (0.2, True), (0.3, False)):
        coupled = constant([[1.0, share], [share, 1.0]])
        found = judge_together(HERTZ, coupled, 0.0 * coupled.real, loops)
        assert found.stable == stable, share
        assert found.interaction == pytest.approx(share * np.abs(loops[0] / (1 + loops[0])).max())


def test_axes_that_are_exchanged_are_a_pole_that_goes_away_without_a_swing():
    """At rest det C < 0: one closed-loop pole is real and positive, half of the curve turns by pi."""
    found = judge_together(
        HERTZ, constant([[1.0, 2.0], [2.0, 1.0]]), np.zeros((2, 2, len(HERTZ))), integrators(5.0, 5.0)
    )
    assert abs(found.turns) == 1
    assert not found.stable
