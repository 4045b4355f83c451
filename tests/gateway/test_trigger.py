"""A trigger is exact to the cycle, however the rows come in pieces, and shows what was before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.errors import UsageError
from micromanip.gateway.fields import fields
from micromanip.gateway.trigger import Condition, Trigger
from micromanip.rt import states

from .rings import AXES, rows

FIELDS = fields(AXES)
EDGE = {"kind": "edge", "field": "x.strain_um", "level": 10.0, "slope": "up"}


def fed(trigger, all_rows, sizes):
    """In pieces of these sizes, again and again; where the window was there first."""
    at, k = 0, 0
    while at < len(all_rows):
        trigger.add(all_rows[at : at + sizes[k % len(sizes)]])
        at += sizes[k % len(sizes)]
        k += 1
        if trigger.window:
            return trigger.window
    return None


@given(st.integers(1, 900), st.lists(st.integers(1, 200), min_size=1), st.integers(0, 50), st.integers(0, 50))
def test_an_edge_is_hit_at_its_cycle(at, sizes, before, after):
    values = np.where(np.arange(1000) < at, 9.999999, 10.0)
    trigger = Trigger(Condition.read(EDGE, FIELDS), "single", before, after, 10**9)
    window = fed(trigger, rows(np.arange(500, 1500), x_strain_um=values), sizes)
    assert trigger.cycle == 500 + at
    assert window == (500 + at - before, 500 + at + after)


@pytest.mark.parametrize(
    ("told", "column", "values", "hit"),
    [
        ({**EDGE, "slope": "down"}, "x_strain_um", [9, 11, 12, 10, 9], 3),
        ({**EDGE, "slope": "either"}, "x_strain_um", [11, 12, 9, 12, 9], 2),
        (EDGE, "x_strain_um", [np.nan, 11, 12, 9, 12], 4),
        ({"kind": "window", "field": "x.strain_um", "low": -1.0, "high": 1.0}, "x_strain_um", [2, 0, 1, 1.01, 0], 3),
        ({"kind": "state", "state": "HOLDING"}, "state", [5, 4, 5, 4, 4], 2),
        ({"kind": "fault"}, "fault", [0, 0, states.SATURATED, states.SATURATED, 0], 2),
        ({"kind": "overrun"}, "periods", [2, 1, 1, 3, 1], 3),
        ({**EDGE, "field": "lateness_ns", "level": 2.0**31}, "lateness_ns", [0, 1, 2**31 - 1, 2**31, 0], 3),
    ],
)
def test_each_kind_is_hit_where_it_comes_true(told, column, values, hit):
    trigger = Trigger(Condition.read(told, FIELDS), "single", 0, 0, 10**9)
    for row in rows(np.arange(len(values)), **{column: values}):
        trigger.add(row.reshape(1))
    assert trigger.cycle == hit


def test_what_comes_within_a_window_is_not_hit_again():
    square = np.where(np.arange(1000) % 100 < 50, 0.0, 20.0)
    trigger = Trigger(Condition.read(EDGE, FIELDS), "normal", 20, 120, 10**9)
    found = []
    for row in np.split(rows(np.arange(1000), x_strain_um=square), 100):
        trigger.add(row)
        if trigger.window:
            found.append(trigger.cycle)
            trigger.arm()
    assert found == [50, 250, 450, 650, 850]


def test_auto_runs_free_where_nothing_comes():
    flat = rows(np.arange(1000))
    for mode, free in (("auto", True), ("normal", False), ("single", False)):
        trigger = Trigger(Condition.read(EDGE, FIELDS), mode, 0, 10, 500)
        trigger.add(flat[:400])
        assert not trigger.runs_free
        trigger.add(flat[400:])
        assert trigger.runs_free is free


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (None, "a trigger is one of edge, window"),
        ({"kind": "edge", "field": "x.strian_um"}, "did you mean x.strain_um"),
        ({**EDGE, "level": float("nan")}, "level is a number from"),
        ({**EDGE, "level": True}, "level is a number from"),
        ({**EDGE, "slope": "sideways"}, "a slope is one of"),
        ({"kind": "window", "field": "x.strain_um", "low": 1, "high": 1}, "low < high"),
        ({"kind": "state", "state": "DANCING"}, "a state is one of OFF"),
    ],
)
def test_what_makes_no_sense_is_refused(told, said):
    with pytest.raises(UsageError, match=said):
        Condition.read(told, FIELDS)
    with pytest.raises(UsageError, match="mode"):
        Trigger(Condition.read(EDGE, FIELDS), "often", 0, 0, 1)
