"""Recurrent network (10)-(12) used as the inverse: displacement to voltage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.hysteresis import NETWORK
from micromanip.rt.network import sigmoid
from micromanip.rt.records import HYSTERESIS_PARAMETERS, HYSTERESIS_STATE, MAX_NEURONS

from .builders import courses, record
from .kernels import network_course

WEIGHT = st.floats(-2.0, 2.0)


def network(w_in, b_in, w_out, b_out, stride=1):
    return record(
        HYSTERESIS_PARAMETERS,
        kind=NETWORK,
        neurons=len(b_in),
        stride=stride,
        w_in=w_in,
        b_in=b_in,
        w_out=w_out,
        b_out=b_out,
    )


def along(p, s, y):
    out = np.zeros(len(y))
    network_course(p, s, np.asarray(y, dtype=float), out)
    return out


def by_the_book(w_in, b_in, w_out, b_out, y, y_before, v_before):
    """(10)-(12) with matrices, X = [y_k, y_k-1, v_k-1]."""
    out = []
    for value in y:
        Z = 1.0 / (1.0 + np.exp(-(w_in @ np.array([value, y_before, v_before]) + b_in)))
        y_before, v_before = value, w_out @ Z + b_out
        out.append(v_before)
    return np.array(out)


@st.composite
def weights(draw):
    m = draw(st.integers(1, 12))

    def numbers(n):
        return np.array(draw(st.lists(WEIGHT, min_size=n, max_size=n)))

    return numbers(3 * m).reshape(m, 3), numbers(m), numbers(m), draw(WEIGHT)


@given(weights(), courses(st.floats(-3.0, 3.0)), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_equations_10_to_12(w, y, y_before, v_before):
    s = record(HYSTERESIS_STATE, y_memory=y_before, v_memory=v_before)
    assert along(network(*w), s, y) == pytest.approx(by_the_book(*w, y, y_before, v_before), rel=1e-12, abs=1e-12)
    assert s["y_memory"] == y[-1]


@given(weights(), courses(st.floats(-3.0, 3.0)), st.integers(2, 7))
def test_stride_moves_the_memory_on_at_the_pace_of_the_training(w, y, stride):
    """With the displacement held over each stride the memory sees just the training's samples."""
    p, s = network(*w, stride=stride), record(HYSTERESIS_STATE)
    out = along(p, s, np.repeat(y, stride))
    expected = by_the_book(*w, y, 0.0, 0.0)
    assert out[stride - 1 :: stride] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert out[::stride] == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_between_strides_the_output_follows_the_displacement_and_the_memory_waits():
    w = np.array([[1.0, 0.5, -0.3]]), np.array([0.1]), np.array([2.0]), 0.2
    p, s = network(*w, stride=3), record(HYSTERESIS_STATE, y_memory=0.4, v_memory=0.7)
    y = [0.5, 0.6, 0.7]
    out = along(p, s, y[:2])
    assert (s["y_memory"], s["v_memory"], s["count"]) == (0.4, 0.7, 2)
    assert out == pytest.approx([by_the_book(*w, [value], 0.4, 0.7)[0] for value in y[:2]])
    assert out[1] > out[0]
    last = along(p, s, y[2:])
    assert (s["y_memory"], s["v_memory"], s["count"]) == (0.7, last[0], 0)


def test_full_width_and_padding():
    rng = np.random.default_rng(1)
    w = rng.normal(size=(MAX_NEURONS, 3)), rng.normal(size=MAX_NEURONS), rng.normal(size=MAX_NEURONS), 0.0
    y = rng.normal(size=50)
    assert along(network(*w), record(HYSTERESIS_STATE), y) == pytest.approx(by_the_book(*w, y, 0.0, 0.0))
    few = network(w[0][:4], w[1][:4], w[2][:4], 0.0)
    few["w_in"][4:], few["b_in"][4:], few["w_out"][4:] = np.nan, np.nan, np.nan
    assert np.isfinite(along(few, record(HYSTERESIS_STATE), y)).all()


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_sigmoid_is_finite_everywhere(x):
    value = sigmoid(x)
    assert 0.0 <= value <= 1.0
    assert value == pytest.approx(0.5 * (1.0 + np.tanh(0.5 * x)), rel=1e-9, abs=1e-15)
