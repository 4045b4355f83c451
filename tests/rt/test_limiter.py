"""The last gate before any output, in volts. The campaign `mutation` shows that no change of it goes unnoticed here."""

import math
import sys

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from micromanip.rt.laws.saturation import attainable, beyond, hold_back, limit, slewed

from .builders import limiter

ANY = st.floats(allow_nan=True, allow_infinity=True)
"""Whatever a broken control law may ask for."""


@st.composite
def gates(draw):
    """Parameters that the configuration accepts: low < high, a positive slew, park inside."""
    low = draw(st.floats(-200.0, 100.0))
    high = low + draw(st.floats(0.1, 400.0))
    return limiter(low, high, draw(st.floats(1e-3, 500.0)), low + draw(st.floats(0.0, 1.0)) * (high - low))


def inside(p, part):
    """A voltage in the range of `p`."""
    return float(max(p["low_V"], min(p["high_V"], p["low_V"] + part * (p["high_V"] - p["low_V"]))))


PART = st.floats(0.0, 1.0)


@given(gates(), ANY, ANY, st.booleans())
@example(limiter(), math.nan, math.nan, True)
@example(limiter(), math.inf, 50.0, True)
@example(limiter(), -math.inf, 50.0, False)
@example(limiter(), 10.0, math.nan, True)
@example(limiter(), 10.0, sys.float_info.max, True)
def test_never_outside_the_range_whatever_comes(p, previous, requested, permitted):
    v = limit(p, previous, requested, permitted)
    assert p["low_V"] <= v <= p["high_V"]  # false for NaN


@given(gates(), PART, ANY, st.booleans())
@example(limiter(), 0.5, math.nan, True)
@example(limiter(), 0.5, math.inf, True)
@example(limiter(), 0.5, -math.inf, True)
def test_never_beyond_the_slew(p, part, requested, permitted):
    previous = inside(p, part)
    v = limit(p, previous, requested, permitted)
    assert previous - p["slew_V"] <= v <= previous + p["slew_V"]


@given(gates(), PART, PART)
def test_never_sluggish(p, part, wanted):
    """What is in reach is reached exactly, towards the rest it goes at the full slew."""
    previous, requested = inside(p, part), inside(p, wanted)
    v = limit(p, previous, requested, True)
    if previous - p["slew_V"] <= requested <= previous + p["slew_V"]:
        assert v == requested
    elif requested > previous:
        assert v == previous + p["slew_V"]
    else:
        assert v == previous - p["slew_V"]


@given(gates(), PART, ANY)
def test_not_permitted_goes_to_park_at_the_slew_limit(p, part, requested):
    previous = inside(p, part)
    assert limit(p, previous, requested, False) == limit(p, previous, p["park_V"], True)


@given(gates(), PART, st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_request_that_is_not_finite_holds(p, part, requested):
    previous = inside(p, part)
    assert limit(p, previous, requested, True) == previous


@given(gates(), ANY, st.sampled_from([math.nan, math.inf, -math.inf]), st.booleans())
def test_a_lost_previous_voltage_parks(p, requested, previous, permitted):
    assert limit(p, previous, requested, permitted) == p["park_V"]


@given(gates(), PART, PART)
def test_arrives_and_stays(p, part, wanted):
    """From anywhere to any voltage in no more steps than the slew needs, and no step after."""
    v, target = inside(p, part), inside(p, wanted)
    p["slew_V"] = max(p["slew_V"], 0.02 * (p["high_V"] - p["low_V"]))
    for _ in range(math.ceil(abs(target - v) / p["slew_V"]) + 1):
        v = limit(p, v, target, True)
    assert v == target
    assert limit(p, v, target, True) == target


IN = limiter(-20.0, 150.0, 4.0, 10.0)


@pytest.mark.parametrize(("requested_V", "end"), [(150.0, 0), (151.0, 1), (-20.0, 0), (-21.0, -1)])
def test_beyond_an_end_no_more_is_to_be_had(requested_V, end):
    assert beyond(IN, requested_V) == end


@pytest.mark.parametrize(
    ("behind", "before", "value", "held"),
    [
        (0, 5.0, 9.0, 9.0),
        (0, 5.0, 1.0, 1.0),
        (1, 0.0, 9.0, 0.0),
        (3, 5.0, 1.0, 1.0),
        (-1, 5.0, 0.0, 5.0),
        (-3, 5.0, 9.0, 9.0),
    ],
)
def test_behind_its_device_an_axis_goes_no_further_that_way(behind, before, value, held):
    assert hold_back(behind, before, value) == held


@pytest.mark.parametrize(
    ("before", "values", "attained"),
    [
        (5.0, (-1.0, 4.0, 11.0), (0.0, 4.0, 10.0)),
        (-3.0, (-5.0, -1.0, 11.0), (-3.0, -1.0, 10.0)),
        (12.0, (-1.0, 11.0, 15.0), (0.0, 11.0, 12.0)),
    ],
)
def test_from_outside_of_its_range_a_set_point_comes_in_and_goes_no_further_out(before, values, attained):
    assert tuple(attainable(0.0, 10.0, before, value) for value in values) == attained


@pytest.mark.parametrize(
    ("before", "value", "after"),
    [
        (1.0, 9.0, 3.0),
        (3.0, 9.0, 5.0),
        (9.0, 5.0, 7.0),
        (9.0, 2.5, 7.0),
        (1.0, 2.5, 2.5),
        (1.0, 3.0, 3.0),
        (5.0, 3.0, 3.0),
    ],
)
def test_a_value_is_led_by_a_step_at_most(before, value, after):
    assert slewed(before, value, 2.0) == after


TABLE = [
    (10.0, 12.0, True, 12.0),  # in reach
    (10.0, 14.0, True, 14.0),  # just in reach
    (10.0, 6.0, True, 6.0),
    (10.0, 14.1, True, 14.0),  # slew, both ways
    (10.0, 5.9, True, 6.0),
    (149.0, 160.0, True, 150.0),  # range, both ends
    (-19.0, -30.0, True, -20.0),
    (150.0, 150.0, True, 150.0),
    (-20.0, -20.0, True, -20.0),
    (200.0, 100.0, True, 150.0),  # outside before: the range wins over the slew
    (-90.0, 100.0, True, -20.0),
    (1e300, 0.0, True, 150.0),
    (200.0, math.nan, True, 150.0),
    (50.0, 50.0, False, 46.0),  # not permitted: to park
    (-5.0, 50.0, False, -1.0),
    (12.0, 50.0, False, 10.0),
    (8.0, math.nan, False, 10.0),
    (10.0, 50.0, False, 10.0),
    (math.nan, 50.0, True, 10.0),  # lost: park
    (math.inf, 50.0, False, 10.0),
]


@pytest.mark.parametrize(("previous", "requested", "permitted", "expected"), TABLE)
def test_table(previous, requested, permitted, expected):
    assert limit(IN, previous, requested, permitted) == expected


def test_park_that_is_not_finite_holds():
    """The configuration refuses it; the gate does not rely on that."""
    p = limiter(park_V=math.nan)
    assert limit(p, 20.0, 50.0, False) == 20.0
