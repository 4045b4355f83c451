"""Play operator (2)-(3)."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.laws.hysteresis import play

from .builders import courses
from .kernels import play_course

INPUTS = st.floats(-100.0, 100.0)
THRESHOLDS = st.floats(0.0, 50.0)


def along(x, r, w=0.0):
    """Outputs along `x` from state `w`."""
    out = np.zeros(len(x))
    play_course(np.asarray(x, dtype=float), r, w, out)
    return out


@pytest.mark.parametrize(
    ("x", "r", "expected"),
    [
        ([0.0, 1.0, 2.0], 0.0, [0.0, 1.0, 2.0]),  # no threshold: the identity
        ([1.0, 3.0, 5.0], 2.0, [0.0, 1.0, 3.0]),  # inside the play nothing moves, then it follows at distance r
        ([5.0, 4.0, 2.0, 1.0, 0.0, -3.0], 2.0, [3.0, 3.0, 3.0, 3.0, 2.0, -1.0]),  # turning: 2 r of lost motion
        ([-5.0, -4.0, 0.0], 2.0, [-3.0, -3.0, -2.0]),
        ([10.0, -10.0, 10.0], 3.0, [7.0, -7.0, 7.0]),
        ([1.0, -1.0, 2.0, -2.0], 2.0, [0.0, 0.0, 0.0, 0.0]),  # never leaves the play
    ],
)
def test_closed_form(x, r, expected):
    assert along(x, r).tolist() == expected


@given(INPUTS, THRESHOLDS)
def test_initial_value_is_equation_3(v0, r):
    assert play(v0, r, 0.0) == np.sign(v0) * max(abs(v0) - r, 0.0)


@given(courses(INPUTS), THRESHOLDS)
def test_output_stays_within_the_threshold_of_the_input(x, r):
    w = along(x, r)
    assert (np.abs(w - x) <= r + 1e-12 * (r + 100.0)).all()


@given(courses(INPUTS), THRESHOLDS, st.data())
def test_rate_independence(x, r, data):
    slow, kept = [x[0]], [0]
    for start, end in itertools.pairwise(x):
        way = data.draw(st.lists(st.floats(min(start, end), max(start, end)), max_size=4))
        slow += sorted(way, reverse=bool(end < start))
        kept.append(len(slow))
        slow.append(end)
    assert (along(slow, r)[kept] == along(x, r)).all()


@given(INPUTS, st.floats(0.0, 100.0), courses(st.floats(0.0, 1.0)), THRESHOLDS, INPUTS, st.booleans())
def test_wipe_out_and_return_point(bottom, height, inside, r, w, downward):
    """What happened between two extremes is forgotten once the later one is reached again."""
    ends = np.array([bottom, bottom + height])
    start, end = ends[::-1] if downward else ends
    minor = np.clip(bottom + height * inside, *ends)
    direct = along([start, end], r, w)
    wandered = along([start, *minor, end], r, w)
    assert wandered[-1] == direct[-1]
    # the loop is closed: once around, and the state is the same again
    assert along([start, end, start, end], r, w)[-1] == direct[-1]
