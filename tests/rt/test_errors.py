"""One error a cycle and axis: what the PID acts on, what is watched and what is scored is the same number."""

import math

import pytest

from micromanip.rt.errors import path_error
from micromanip.rt.states import FOLLOWING_ERROR, HOLDS

from .bench_cell import X, Y, tracking


def test_the_fault_tells_the_error_that_the_pid_acted_on():
    """The set-point moves by 0.06 um a cycle: the error of another cycle would be another number."""
    cell = tracking()
    watch = cell.p["axis"][Y]["watch"]
    watch["reaction"][FOLLOWING_ERROR], watch["following_cycles"] = HOLDS, 1
    for _ in range(100):
        cell.step()
        acted_on = abs(float(cell.s["axis"][Y]["pid"]["error"]))
    assert acted_on > 0.0
    watch["following_um"] = 0.5 * acted_on
    cell.step()
    assert cell.s["fault"] == FOLLOWING_ERROR
    assert cell.s["fault_value"] == acted_on


def test_the_scored_error_is_the_watched_one():
    cell = tracking()
    watch = cell.p["axis"][X]["watch"]
    watch["reaction"][FOLLOWING_ERROR], watch["following_cycles"] = HOLDS, 1
    cell.run(100)
    errors = int(cell.s["figures"][X]["errors"])
    squares = float(cell.s["figures"][X]["error_squares"])
    cell.step()
    assert cell.s["figures"][X]["errors"] == errors + 1
    scored = math.sqrt(float(cell.s["figures"][X]["error_squares"]) - squares)
    watch["following_um"] = 0.5 * scored
    cell.step()
    assert cell.s["fault_value"] == pytest.approx(scored, rel=1e-6)


def test_a_held_sample_keeps_its_error():
    cell = tracking()
    cell.run(50)
    before = float(cell.s["axis"][Y]["strain_error_um"])
    cell.spoiled["strain", Y] = None
    cell.step()
    assert cell.s["axis"][Y]["strain_error_um"] == before
    assert cell.s["axis"][Y]["error_fresh"] == 0
    assert path_error(cell.p["axis"][X], cell.s["axis"][X], cell.signals)[0] == cell.s["axis"][X]["stage_error_um"]
