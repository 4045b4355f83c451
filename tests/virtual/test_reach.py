"""A path that goes further than the stage: followed to the end of the set-point's range, and back from there."""

from pathlib import Path

import numpy as np
import pytest

from micromanip.rt.states import NO_FAULT, TRACKING
from micromanip.settings.check import prepare
from micromanip.settings.checks.ranges import range_warnings
from micromanip.virtual.cell import VirtualCell

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
LOW_UM, SECONDS = 46.0, 5.0
"""Axis x of a weaker actuator; its path is out of reach for seconds on end."""


@pytest.fixture(scope="module")
def weak(tmp_path_factory):
    file = tmp_path_factory.mktemp("reach") / "cell.yaml"
    text = CONFIG.read_text(encoding="utf-8")
    file.write_text(text.replace("range_um: [2, 128], slew", f"range_um: [{LOW_UM:g}, 128], slew", 1), encoding="utf-8")
    return prepare(file)


def played(prepared):
    cell = VirtualCell(prepared.parameters, prepared.wiring)
    cell.arm()
    rows = cell.run(SECONDS)
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    return rows["axis"][:, 0]


def test_it_is_told_how_far_each_axis_reaches(weak):
    ((key, said),) = range_warnings(weak.configuration)
    assert key == ("axes", "x", "setpoint", "range_um")
    assert said.startswith("axis x reaches -100 to 310 um by its model, without force, of the -300 to 300 um")
    assert said.endswith("with centre_um at the middle of its set-points, 87 um, it would reach -205 to 205 um")
    assert list(range_warnings(prepare(CONFIG).configuration)) == []


def test_a_path_out_of_reach_is_not_lost(weak):
    """Its samples were refused, as if no such deviation could be: the path was held where it had left, then X-301."""
    limited, whole = played(weak), played(prepare(CONFIG))
    at_end = limited["setpoint_um"] <= LOW_UM
    ends = np.flatnonzero(np.diff(np.concatenate([[0], at_end, [0]])))
    assert (ends[1::2] - ends[::2]).max() > 5000, "longer than a tracker may be silent"
    lost_um = np.abs(limited["true_stage_um"] - whole["true_stage_um"])
    since = np.arange(len(at_end)) - np.maximum.accumulate(np.where(at_end, np.arange(len(at_end)), -(10**6)))
    assert lost_um[at_end].max() > 50.0
    assert lost_um[(since > 20) & (since < 10**6)].max() < 10.0, "2 ms after it is back in reach"
    assert lost_um[(since > 200) & (since < 10**6)].max() < 1.0
    assert np.abs(np.diff(limited["setpoint_um"])).max() <= 2.0, "never faster than its slew limit"
