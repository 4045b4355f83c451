"""Recurrent network (10)-(12) used as the inverse: displacement to voltage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS, HYSTERESIS_STATE, NETWORK
from micromanip.rt.laws.network import sigmoid, start_network

from .builders import courses, record
from .kernels import network_course

WEIGHT = st.floats(-2.0, 2.0)


def network(w_in, b_in, w_out, b_out, reversal_um=1e-9):
    weights = {"w_in": w_in, "b_in": b_in, "w_out": w_out, "b_out": b_out}
    return record(HYSTERESIS_PARAMETERS, kind=NETWORK, neurons=len(b_in), reversal_um=reversal_um, **weights)


def along(p, s, y):
    out = np.zeros(len(y))
    network_course(p, s, np.asarray(y, dtype=float), out)
    return out


def turning_points(y, reversal):
    """Samples before which the memory moves, looked at all at once: back from the extreme of the branch."""
    moves, first, way = set(), 0, 0.0
    for k in range(1, len(y)):
        branch = np.asarray(y[first : k + 1])
        if way == 0.0:
            way = np.sign(branch[-1] - branch[0])
        extreme = branch.max() if way > 0 else branch.min()
        if way * (extreme - branch[-1]) > reversal:
            moves.add(k)
            first, way = k, -way
    return moves


def by_the_book(w_in, b_in, w_out, b_out, y, y_memory, v_memory, moves):
    """(10)-(12) with matrices, X = [y_k, y_m, v_m]."""
    out = []
    for k, value in enumerate(y):
        if k in moves:
            y_memory, v_memory = y[k - 1], out[k - 1]
        Z = 1.0 / (1.0 + np.exp(-(w_in @ np.array([value, y_memory, v_memory]) + b_in)))
        out.append(w_out @ Z + b_out)
    return np.array(out)


@st.composite
def weights(draw):
    m = draw(st.integers(1, 12))

    def numbers(n):
        return np.array(draw(st.lists(WEIGHT, min_size=n, max_size=n)))

    return numbers(3 * m).reshape(m, 3), numbers(m), numbers(m), draw(WEIGHT)


@given(weights(), courses(st.floats(-3.0, 3.0)), st.floats(-3.0, 3.0), st.floats(0.0, 1.0))
def test_equations_10_to_12_with_the_last_turning_point_as_memory(w, y, v_before, reversal):
    s = record(HYSTERESIS_STATE)
    start_network(s, y[0], v_before)
    expected = by_the_book(*w, y, y[0], v_before, turning_points(y, reversal))
    assert along(network(*w, reversal), s, y) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(weights(), courses(st.floats(-3.0, 3.0)), st.integers(2, 5))
def test_a_branch_does_not_depend_on_the_loops_rate(w, y, times):
    """Sampled more often on its way, the displacement gets the same voltage where both look."""
    coarse, fine = record(HYSTERESIS_STATE), record(HYSTERESIS_STATE)
    start_network(coarse, y[0], 0.1)
    start_network(fine, y[0], 0.1)
    p = network(*w, 0.5)
    held = along(p, fine, np.repeat(y, times))
    assert along(p, coarse, y) == pytest.approx(held[::times], rel=1e-12, abs=1e-12)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_sigmoid_is_finite_everywhere(x):
    value = sigmoid(x)
    assert 0.0 <= value <= 1.0
    assert value == pytest.approx(0.5 * (1.0 + np.tanh(0.5 * x)), rel=1e-9, abs=1e-15)
