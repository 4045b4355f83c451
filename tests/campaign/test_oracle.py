"""The oracle sees each thing that it is there for, and nothing in what is as it must be."""

import math

import pytest

from campaigns.oracle import Arrival, Arrivals, Bounds, Oracle

MS = 1_000_000
BOUNDS = {"x": Bounds(-20.0, 100.0, 5.0, 0.0, 1e-3), "y": Bounds(-20.0, 100.0, 5.0, 10.0, 1e-3)}


def judged(*given, armed_ms=(), claims_ms=(), settled=True, bounds=BOUNDS):
    """Rules that are broken by values (ms, name, V, and True where the device moved by itself)."""
    arrivals = Arrivals()
    oracle = Oracle(arrivals, bounds)
    for at_ms, name, volts, *itself in given:
        arrivals.take_up(Arrival(at_ms * MS, name, volts, any(itself)))
    if settled:
        oracle.settled()
    for at_ms in armed_ms:
        oracle.armed(at_ms * MS)
    for at_ms in claims_ms:
        oracle.claim(at_ms * MS, at_ms * MS, "it says so")
    return [violation.rule for violation in oracle.judge(0, 10**12)]


def ramp(begin_ms, *volts, name="x"):
    return [(begin_ms + 10 * k, name, value) for k, value in enumerate(volts)]


UP_AND_DOWN = ramp(100, 5.0, 10.0, 15.0, 10.0, 5.0, 0.0)


def test_armed_course_within_its_limits():
    assert judged(*UP_AND_DOWN, armed_ms=[90], claims_ms=[50, 160]) == []


@pytest.mark.parametrize("volts", [100.1, -20.1, math.nan, math.inf])
def test_range(volts):
    assert "range" in judged((10, "x", volts), armed_ms=[0])


def test_slew_whatever_happened_between():
    assert judged((10, "x", 5.0), (9_000, "x", 10.01), armed_ms=[0]) == ["slew"]


def test_what_a_device_does_by_itself_is_where_the_next_value_begins():
    assert judged(*ramp(10, 5.0, 10.0, 15.0), (60, "x", 0.0, True), (70, "x", 4.0), armed_ms=[0]) == []
    assert judged(*ramp(10, 5.0, 10.0, 15.0), (60, "x", 0.0, True), (70, "x", 15.0), armed_ms=[0]) == ["slew"]
    assert judged((60, "x", 30.0, True), (70, "x", 26.0)) == []


def test_nothing_moves_unarmed():
    assert judged(*UP_AND_DOWN) == ["unarmed"]
    assert judged(*UP_AND_DOWN, armed_ms=[115]) == ["unarmed"]


def test_rest_is_each_output_s_own():
    assert judged((10, "y", 10.0), (20, "x", 0.0)) == []
    assert judged((10, "y", 10.0), (20, "y", 9.0)) == ["unarmed"]


def test_an_arming_is_over_after_a_second_at_rest():
    rest = ramp(160, *[0.0] * 110)
    assert judged(*UP_AND_DOWN, *rest[:50], *ramp(700, 5.0, 0.0), armed_ms=[90]) == []
    assert judged(*UP_AND_DOWN, *rest, *ramp(1_300, 5.0, 0.0), armed_ms=[90]) == ["unarmed"]
    assert judged(*UP_AND_DOWN, *rest, *ramp(1_300, 5.0, 0.0), armed_ms=[90, 1_290]) == []


def test_an_arming_at_rest_counts_until_its_first_voltage():
    """Values at rest go on arriving after `arm` was asked for: they are not yet what it leads to."""
    rest = ramp(0, *[0.0] * 150)
    assert judged(*rest, *ramp(1_500, 5.0, 0.0), armed_ms=[1_455]) == []


def test_claim_while_the_device_is_elsewhere():
    held = ramp(100, 5.0, 10.0, 15.0)
    assert judged(*held, *ramp(900, 10.0, 5.0, 0.0), armed_ms=[90], claims_ms=[500]) == ["claim"]
    assert judged(*held, *ramp(900, 10.0, 5.0, 0.0), armed_ms=[90], claims_ms=[850]) == [], "that is on its way"
    assert judged(*held, armed_ms=[90], claims_ms=[5_000]) == ["claim"]


def test_claim_of_a_device_that_left_rest_by_itself():
    assert judged((100, "x", 30.0, True), claims_ms=[500]) == []
    assert judged((100, "x", 30.0, True), claims_ms=[1_500]) == ["claim"]


def test_change_of_range():
    arrivals = Arrivals()
    oracle = Oracle(arrivals, {"x": BOUNDS["x"]})
    oracle.change({"x": Bounds(-20.0, 50.0, 60.0, 0.0, 1e-3)}, 100 * MS)
    oracle.armed(0)
    for at_ms in (200, 900):
        arrivals.take_up(Arrival(at_ms * MS, "x", 60.0))
    assert [violation.rule for violation in oracle.judge(0, 10**12)] == ["range"], "after a while"


def test_the_last_value_is_remembered_from_one_interleaving_to_the_next():
    arrivals = Arrivals()
    oracle = Oracle(arrivals, {"x": BOUNDS["x"]})
    oracle.armed(0)
    arrivals.take_up(Arrival(10 * MS, "x", 5.0))
    assert oracle.judge(0, 20 * MS) == []
    oracle.armed(25 * MS)
    arrivals.take_up(Arrival(30 * MS, "x", 11.0))
    assert [violation.rule for violation in oracle.judge(20 * MS, 40 * MS)] == ["slew"]
