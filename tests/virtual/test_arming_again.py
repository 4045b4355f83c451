"""A gauge that goes wrong between two sessions: the next arming finds it before a loop is closed on it."""

import numpy as np
import pytest

from micromanip.rt.phases import CLOSED, SWEEPING
from micromanip.rt.states import ARM, DISARM, FAULT, READY, STRAIN_CHECK

from .test_arming import cell

AT_REST_S = 6.0
"""When the first session is over, and the outputs have come to rest."""


def second_session(tmp_path, *faults):
    """The cell after a session that was well; `faults` of its gauges come while it rests."""
    listed = ", ".join(f"{{at_s: {AT_REST_S}, {fault}}}" for fault in faults)
    armed = cell(tmp_path, ("    lines: {", f"    faults: [{listed}]\n    lines: {{"))
    armed.arm()
    armed.run(0.5)
    assert armed.run(1.2, command=DISARM)["state"][-1] == READY
    armed.run(AT_REST_S + 0.1 - armed.state[0]["cycle"] * 1e-4)
    return armed


def armed_again(armed):
    before = armed.run(0.1)["axis"]["true_stage_um"][-1]
    rows = armed.run(3.0, command=ARM)
    return rows, np.abs(rows["axis"]["true_stage_um"] - before).max(axis=0)


@pytest.mark.parametrize("scale", [0.01, -1.0, 0.1, 8.0])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_gauge_that_shows_too_little_too_much_or_the_wrong_sense(tmp_path, scale, axis):
    wrong = second_session(tmp_path, f"channel: strain_{'xyz'[axis]}, kind: scale, value: {scale}")
    rows, moved_um = armed_again(wrong)
    s = wrong.state[0]
    assert (s["state"], s["fault"], s["fault_axis"]) == (FAULT, STRAIN_CHECK, axis)
    assert CLOSED not in rows["phase"]
    assert SWEEPING not in rows["phase"]
    assert rows["axis"]["voltage_V"][:, axis].max() < 30.0
    assert moved_um[axis] < 150.0


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_two_gauges_plugged_the_other_way_round(tmp_path, pair):
    swapped = second_session(tmp_path)
    one, other = (swapped.parameters[0]["axis"][i] for i in pair)
    one["strain"], other["strain"] = int(other["strain"]), int(one["strain"])
    rows, _ = armed_again(swapped)
    s = swapped.state[0]
    assert (s["state"], s["fault"]) == (FAULT, STRAIN_CHECK)
    assert s["fault_axis"] in pair
    assert SWEEPING not in rows["phase"]
    assert rows["axis"]["voltage_V"].max() < 60.0
