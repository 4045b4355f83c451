"""Which loops arming checks, and what lets a check count no more."""

import math

import numpy as np
import pytest

from micromanip.rt.arming import (
    OF_GAUGE,
    OF_STAGE,
    arming_cycles,
    carry_checks,
    forget_checks,
    judge,
    plan_checks,
    planned_cycles,
    stage_loss,
)
from micromanip.rt.checks import keep_checks
from micromanip.rt.records import AXIS_PARAMETERS, AXIS_STATE, CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import (
    AMPLIFIER_FAULT,
    DISAGREEMENT,
    DRIVER_ERROR,
    ENABLE_LOST,
    FOLLOWING_ERROR,
    INTERLOCK_OPEN,
    LINK_LOST,
    NO_FAULT,
    STAGE,
    STAGE_CHECK,
    STAGE_INVALID,
    STAGE_STUCK,
    STRAIN,
    STRAIN_CHECK,
    STRAIN_INVALID,
    STRAIN_STUCK,
    VOLTAGE,
)

PERIOD_NS = 100_000


def cell(*modes):
    """Parameters and state at rest: sensors well, every check passed."""
    p, s = np.zeros(1, CELL_PARAMETERS)[0], np.zeros(1, CELL_STATE)[0]
    p["axes"], p["period_ns"], p["check_cycles"] = len(modes), PERIOD_NS, 100
    p["lift_cycles"], p["authority_cycles"] = 1000, 10
    for i, mode in enumerate(modes):
        axis, a, own = p["axis"][i], s["axis"][i], s["arming"][i]
        axis["mode"], axis["cycles_per_ns"] = mode, 1.0 / PERIOD_NS
        a["strain"]["sequence"] = a["stage"]["sequence"] = 5
        axis["check"]["low"], axis["check"]["high"] = 0.5, 2.0
        assert all(judge(own["check"][kind], axis["check"][kind], 1.0) for kind in (OF_GAUGE, OF_STAGE))
    return p, s


def passed(s, axes=3):
    return [(int(a["check"][OF_GAUGE]["passed"]), int(a["check"][OF_STAGE]["passed"])) for a in s["arming"][:axes]]


def turns(s, axes=3):
    return [(int(a["check"][OF_GAUGE]["turn"]), int(a["check"][OF_STAGE]["turn"])) for a in s["arming"][:axes]]


def test_a_new_cell_is_checked_as_far_as_its_modes_close_loops():
    p, s = cell(STAGE, VOLTAGE, STRAIN)
    for axis in range(3):
        forget_checks(s["arming"][axis], OF_GAUGE)
    assert planned_cycles(p, s) == 3 * 100 + 1010
    assert turns(s) == [(1, 1), (0, 0), (2, 0)]
    assert tuple(s["checks"]) == (2, 1)


def test_what_counts_is_not_checked_again():
    p, s = cell(STAGE, STAGE, STAGE)
    assert planned_cycles(p, s) == 1010
    forget_checks(s["arming"][1], OF_STAGE)
    forget_checks(s["arming"][2], OF_GAUGE)
    assert planned_cycles(p, s) == 3 * 100 + 1010
    assert turns(s) == [(0, 0), (0, 1), (1, 2)]
    s["resumed"] = 1
    assert arming_cycles(p, s) == 10


def test_without_a_time_for_it_nothing_is_checked():
    p, s = cell(STAGE, STAGE, STAGE)
    p["check_cycles"] = 0
    forget_checks(s["arming"][0], OF_GAUGE)
    plan_checks(p, s)
    assert turns(s) == [(0, 0)] * 3


def test_at_rest_with_all_well_every_check_goes_on_counting():
    p, s = cell(STAGE, STAGE, STAGE)
    s["raised"] = 1 << INTERLOCK_OPEN | 1 << ENABLE_LOST
    s["watch"]["raised"] = 1 << FOLLOWING_ERROR
    s["axis"]["stage"]["bad"] = 100_000  # the stage is out of its sensor's range, which says so
    keep_checks(p, s)
    assert passed(s) == [(1, 1)] * 3


@pytest.mark.parametrize("code", [DRIVER_ERROR, LINK_LOST])
def test_a_fault_of_the_cell_after_which_all_is_checked(code):
    p, s = cell(STAGE, STAGE, STAGE)
    s["raised"] = 1 << code
    keep_checks(p, s)
    assert passed(s) == [(0, 0)] * 3


def test_a_link_that_is_down_at_rest():
    p, s = cell(STAGE, STAGE, STAGE)
    s["link_down"] = 1
    keep_checks(p, s)
    assert passed(s) == [(0, 0)] * 3


@pytest.mark.parametrize(
    ("code", "after"),
    [(code, (0, 0)) for code in (STRAIN_INVALID, STRAIN_STUCK, DISAGREEMENT, AMPLIFIER_FAULT, STRAIN_CHECK)]
    + [(code, (1, 0)) for code in (STAGE_INVALID, STAGE_STUCK, STAGE_CHECK)],
)
def test_a_fault_of_an_axis_after_which_it_is_checked(code, after):
    p, s = cell(STAGE, STAGE, STAGE)
    s["watch"][1]["raised"] = 1 << code
    keep_checks(p, s)
    assert passed(s) == [(1, 1), after, (1, 1)]


@pytest.mark.parametrize(
    ("sensor", "field", "value", "after"),
    [
        ("strain", "silent_ns", 1001 * PERIOD_NS, (0, 0)),
        ("strain", "silent_ns", 999 * PERIOD_NS, (1, 1)),
        ("strain", "bad", 1000, (0, 0)),
        ("strain", "bad", 999, (1, 1)),
        ("stage", "silent_ns", 1001 * PERIOD_NS, (1, 0)),
        ("stage", "silent_ns", 999 * PERIOD_NS, (1, 1)),
    ],
)
def test_a_sensor_that_was_unplugged_at_rest_may_be_another_one(sensor, field, value, after):
    p, s = cell(STAGE, STAGE, STAGE)
    s["axis"][2][sensor][field] = value
    keep_checks(p, s)
    assert passed(s) == [(1, 1), (1, 1), after]


def axis(mode=STAGE):
    p, s = cell(mode)
    return p["axis"][0], s["arming"][0]


def test_the_same_parameters_keep_both_checks():
    old, a = axis()
    carry_checks(old, old.copy(), a)
    assert (a["check"][OF_GAUGE]["passed"], a["check"][OF_STAGE]["passed"]) == (1, 1)


@pytest.mark.parametrize("name", ["mode", "strain", "stage", "voltage", "low_V", "high_V", "slew_V", "park_V"])
def test_another_mode_signal_or_output_is_checked(name):
    old, a = axis()
    new = old.copy()
    (new["limiter"] if name.endswith("_V") else new)[name] += 1
    carry_checks(old, new, a)
    assert (a["check"][OF_GAUGE]["passed"], a["check"][OF_STAGE]["passed"]) == (0, 0)


@pytest.mark.parametrize(("check", "after"), [(OF_GAUGE, (0, 0)), (OF_STAGE, (1, 0))])
def test_what_was_found_is_judged_by_what_is_expected_now(check, after):
    old, a = axis()
    new = old.copy()
    new["check"][check]["high"] = 1.1
    carry_checks(old, new, a)
    assert (a["check"][OF_GAUGE]["passed"], a["check"][OF_STAGE]["passed"]) == (1, 1)
    new["check"][check]["high"] = 0.9
    carry_checks(old, new, a)
    assert (a["check"][OF_GAUGE]["passed"], a["check"][OF_STAGE]["passed"]) == after


def sensor(**fields):
    """An axis whose capacitive sensor reads the middle of +-300 um, but for `fields`."""
    p, s = np.zeros(1, AXIS_PARAMETERS)[0], np.zeros(1, AXIS_STATE)[0]
    p["mode"], p["cycles_per_ns"], p["stage_age_ns"] = STAGE, 1.0 / PERIOD_NS, 3 * PERIOD_NS
    p["stage_range_um"] = -300.0, 300.0
    p["watch"]["stage_identical"] = 20
    s["stage"]["sequence"] = 9
    for name, value in fields.items():
        s["stage"][name] = value
    return p, s


@pytest.mark.parametrize(
    ("fields", "at_rest", "to_close"),
    [
        ({}, NO_FAULT, NO_FAULT),
        ({"sequence": 0}, STAGE_INVALID, STAGE_INVALID),
        ({"silent_ns": 5 * PERIOD_NS}, STAGE_INVALID, STAGE_INVALID),
        ({"silent_ns": 4 * PERIOD_NS - 10}, NO_FAULT, NO_FAULT),
        ({"reading": math.nan, "bad": 1}, STAGE_INVALID, STAGE_INVALID),
        # a stage at rest reads the same, a coarse sensor anywhere, each at an end of its range, flagged or not
        ({"identical": 20}, NO_FAULT, STAGE_STUCK),
        ({"identical": 19}, NO_FAULT, NO_FAULT),
        ({"reading": -300.0, "bad": 900, "identical": 900}, NO_FAULT, STAGE_INVALID),
        ({"reading": -299.9, "identical": 900}, NO_FAULT, STAGE_STUCK),
        ({"reading": 450.0, "bad": 900, "identical": 900}, NO_FAULT, STAGE_INVALID),
    ],
)
def test_what_a_capacitive_sensor_may_be_like(fields, at_rest, to_close):
    p, s = sensor(**fields)
    assert stage_loss(p, s, 1, False) == at_rest
    assert stage_loss(p, s, 1, True) == to_close
