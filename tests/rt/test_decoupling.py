"""Decoupling: the sum it adds, shares that are eased, and an axis that is not there."""

import numpy as np
import pytest

from micromanip.rt.cell import decouple
from micromanip.rt.laws.decoupling import EASED
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import CLOSED, PARKING, TRACKING

LEAD_S = 7e-4
SHARE = (0.0, 0.01, -0.004)


def cell(share=SHARE):
    p, s = np.zeros(1, CELL_PARAMETERS), np.zeros(1, CELL_STATE)
    p[0]["axes"], s[0]["state"] = 3, TRACKING
    p[0]["axis"]["authority_step"] = 0.1
    law = p[0]["axis"][0]["decoupling"]
    law["active"], law["lead_s"], law["share"] = 1, LEAD_S, share
    s[0]["axis"]["estimator"]["running"], s[0]["order"]["phase"] = 1, CLOSED
    w = s[0]["axis"]["reference"]["w"]
    w[1, :5], w[2, :5] = (80.0, 300.0, 9e9, 5.0, -40.0), (-50.0, 10.0, 0.0, 0.0, 0.0)
    return p[0], s[0]


def added(s):
    return float(s["axis"][0]["decoupling"]["added_um"])


def test_it_adds_what_the_closed_form_says_after_it_was_eased_in():
    p, s = cell()
    seen = []
    for _ in range(20):
        decouple(p, s)
        seen.append(added(s))
    parts = [-0.01 * (85.0 + LEAD_S * 260.0), 0.004 * (-50.0 + LEAD_S * 10.0)]
    assert seen[-1] == pytest.approx(sum(parts), rel=1e-12)
    assert seen[4] == pytest.approx(parts[0] / 2 + parts[1], rel=1e-9), (
        "a tenth of EASED a cycle: .004 is there, .01 half"
    )
    step = EASED * 0.1 * (85.0 + 50.0 + LEAD_S * 270.0)
    assert np.abs(np.diff([0.0, *seen])).max() <= step * (1 + 1e-9)
    assert [float(axis["decoupling"]["added_um"]) for axis in s["axis"][1:]] == [0.0, 0.0]


def test_switched_off_it_goes_as_it_came_and_then_nothing_is_active():
    p, s = cell()
    for _ in range(20):
        decouple(p, s)
    p["axis"][0]["decoupling"]["active"], p["axis"][0]["decoupling"]["share"] = 0, 0.0
    before = added(s)
    decouple(p, s)
    assert abs(before) > abs(added(s)) > 0.5 * abs(before)
    for _ in range(20):
        decouple(p, s)
    assert added(s) == 0.0
    assert s["axis"][0]["decoupling"]["active"] == 0


def test_an_axis_that_is_not_closed_adds_nothing_and_begins_anew():
    p, s = cell()
    for _ in range(20):
        decouple(p, s)
    s["order"]["phase"] = PARKING
    decouple(p, s)
    assert added(s) == 0.0
    assert not s["axis"][0]["decoupling"]["share"].any()
