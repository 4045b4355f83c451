"""Decoupling: the sum it adds, and an axis that is not there."""

import numpy as np
import pytest

from micromanip.rt.cell import decouple
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import CLOSED, PARKING, TRACKING

LEAD_S = 7e-4
SHARE = (0.0, 0.01, -0.004)


def cell(share=SHARE):
    p, s = np.zeros(1, CELL_PARAMETERS), np.zeros(1, CELL_STATE)
    p[0]["axes"], s[0]["state"] = 3, TRACKING
    law = p[0]["axis"][0]["decoupling"]
    law["active"], law["lead_s"], law["share"] = 1, LEAD_S, share
    s[0]["axis"]["estimator"]["running"], s[0]["order"]["phase"] = 1, CLOSED
    w = s[0]["axis"]["reference"]["w"]
    w[1, :5], w[2, :5] = (80.0, 300.0, 9e9, 5.0, -40.0), (-50.0, 10.0, 0.0, 0.0, 0.0)
    return p[0], s[0]


def added(s):
    return float(s["axis"][0]["added_um"])


def test_it_adds_what_the_closed_form_says():
    p, s = cell()
    decouple(p, s)
    parts = [-0.01 * (85.0 + LEAD_S * 260.0), 0.004 * (-50.0 + LEAD_S * 10.0)]
    assert added(s) == pytest.approx(sum(parts), rel=1e-12)
    assert s["axis"]["added_um"][1:].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("what", ["switched off", "parking", "no estimate"])
def test_nothing_is_added(what):
    p, s = cell()
    decouple(p, s)
    if what == "switched off":
        p["axis"][0]["decoupling"]["active"] = 0
    elif what == "parking":
        s["order"]["phase"] = PARKING
    else:
        s["axis"]["estimator"]["running"] = 0
    decouple(p, s)
    assert added(s) == 0.0
