"""When the sensitivity of a loop may not be measured: who asks is told why, and nothing is injected."""

import pytest

from micromanip.errors import CheckFailed, UsageError

from .standin import Cell, jogging


@pytest.fixture
def cell(tmp_path):
    cell = Cell(tmp_path, jogging())
    cell.controller.status["state"][0]["axis"]["setpoint_um"] = 60.0
    return cell


def refused(cell, message, error=CheckFailed, **fields):
    with pytest.raises(error, match=message):
        cell("analyse_live", **fields)
    assert cell.controller.swaps == []


@pytest.mark.parametrize("state", ["READY", "ARMING", "RAMPING", "FAULT"])
def test_only_while_it_tracks_or_is_held(cell, state):
    cell.controller.state = state
    refused(cell, f"the state is {state}; a loop is measured while TRACKING or HOLDING", axis="x")
    assert cell.entries[-1][:2] == ("analyse_live", False)


def test_only_a_loop_that_is_closed(cell):
    refused(cell, "axis x is in mode strain, its stage loop is open", axis="x", loop="stage")
    cell("set", changes={"axes.x.inner.mode": "feedforward"})
    cell.controller.swaps.clear()
    refused(cell, "inner.mode of axis x is feedforward, its strain loop is open", axis="x")


def test_only_inside_range_and_slew(cell):
    refused(
        cell, r"5 um rms would move axis x at \d+ % of setpoint.slew_um_per_ms; at most", axis="x", amplitude_um=5.0
    )
    cell.controller.status["state"][0]["axis"][1]["setpoint_um"] = 127.5
    refused(cell, r"the set-point of axis y is 127.5 um, too near to the end of its range 2 to 128 um", axis="y")


def test_only_what_makes_sense(cell):
    refused(cell, "there is no axis 'w'", UsageError, axis="w")
    refused(cell, "axis: missing", UsageError)
    refused(cell, "unknown key axis", UsageError, axis="x", number=1)
    refused(cell, "there is no measurement 1, the last is 0", UsageError, number=1)
    refused(cell, "amplitude_um", UsageError, axis="x", amplitude_um=0.0)


def test_not_beside_a_candidate(cell):
    cell("candidate_set", changes={"axes.x.inner.K_V_per_um": 0.5})
    refused(cell, "a candidate is compared; `micromanip candidate discard` lets it go", axis="x")
