"""Sums in machine code of their own: what plain Python makes of them, to the last bit."""

import numpy as np
import pytest

from micromanip.rt.laws.estimator import MAX_STATES, filled, in_blocks
from micromanip.rt.laws.lqg import OUTER_PARAMETERS
from micromanip.rt.sums import advance_model, correct, weighted

from .builders import record
from .kernels import sums_course


@pytest.mark.parametrize("states", [1, 4, 7, 15, 16, 17, 31, MAX_STATES])
def test_they_are_those_of_their_definition(states):
    rng = np.random.default_rng(states)
    x, scratch, y = np.zeros(MAX_STATES), np.zeros(MAX_STATES), np.zeros(1)
    x[:states] = rng.normal(size=states)
    A, b, c = rng.normal(size=(states, states)), rng.normal(size=states), rng.normal(size=states)
    p = record(OUTER_PARAMETERS, states=states, a_blocks=in_blocks(A), b=b, c=c)
    expected = x.copy()
    read = weighted(p["c"], x, filled(p))
    advance_model(p["a_blocks"], b, 0.3, expected, np.zeros(states), states)
    assert expected[:states] == pytest.approx(A @ x[:states] + 0.3 * b)
    assert read == pytest.approx(c @ x[:states])
    correct(expected, p["c"], read, np.zeros(MAX_STATES), expected, states)
    sums_course(p, x, scratch, 0.3, y)
    assert (np.array([x, scratch]) == expected).all()
