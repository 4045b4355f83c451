"""When an axis may not be moved: who asks is told why and what would be right, and nothing is put into the loop."""

import pytest

from micromanip.errors import CheckFailed, UsageError

from .standin import Cell, jogging

STEP = {"axis": "x", "kind": "step", "by_um": 5.0}


@pytest.fixture
def cell(tmp_path):
    cell = Cell(tmp_path, jogging(), state="HOLDING")
    axes = cell.controller.status["state"][0]["axis"]
    axes["setpoint_um"], axes["voltage_V"] = 60.0, 70.0
    return cell


def refused(cell, message, error=CheckFailed, **fields):
    with pytest.raises(error, match=message):
        cell("move", **fields)
    assert cell.controller.injected == []


@pytest.mark.parametrize("state", ["READY", "ARMING", "TRACKING", "RAMPING", "FAULT"])
def test_only_while_it_is_held(cell, state):
    cell.controller.state = state
    refused(cell, f"the state is {state}; an axis is moved while HOLDING", **STEP)
    assert cell.entries[-1][:2] == ("move", False)


def test_not_where_it_is_held_for_a_fault(cell):
    cell.controller.latched.append(type("Fault", (), {"seen": "X-301 the tracker is lost"}))
    refused(cell, "it is held because of a fault: X-301", **STEP)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"kind": "step", "by_um": 69.0}, r"from 60.0 to 129.0 um, setpoint.range_um is 2 to 128 um; it is held at 60"),
        ({"kind": "waypoints", "places_um": [3.0, -59.0]}, r"from 1.0 to 63.0 um"),
        ({"kind": "sine", "amplitude_um": 1.5, "frequency_Hz": 66.0, "seconds": 1.0}, "above 10 Hz a flexure may"),
        ({"kind": "sweep", "amplitude_um": 2.0, "frequency_Hz": 1.0, "to_Hz": 11.0, "seconds": 9.0}, "at most 1 um"),
        ({"kind": "step", "by_um": 2.0, "way_s": 0.05}, "way_s of at least 0.1 s beyond 1 um"),
        ({"kind": "waypoints", "places_um": [1.0] * 15, "rest_s": 9.0}, "it takes 147.2 s, at most 60 s"),
    ],
)
def test_only_inside_what_the_limits_allow(cell, wanted, message):
    refused(cell, message, axis="x", **wanted)


def test_only_inside_the_voltage_that_the_model_predicts(cell):
    cell.controller.status["state"][0]["axis"]["voltage_V"] = 140.0
    refused(cell, r"would take the voltage of axis x from \d+.\d to 1[5-9]\d.\d V, its range is -20 to 150 V",
            **STEP | {"by_um": 20.0})  # fmt: skip


def test_no_faster_than_half_of_the_slew_limit(cell):
    cell("set", changes={"axes.x.setpoint.slew_um_per_ms": 0.5})
    refused(
        cell, "at 562 um/s, at most 250 um/s: 50 % of setpoint.slew_um_per_ms", **STEP | {"by_um": 30.0, "way_s": 0.1}
    )
    refused(
        cell, r"at \d+ um/s, at most 250 um/s", axis="x", kind="sine", amplitude_um=8.0, frequency_Hz=5.0, seconds=1.0
    )


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "step", "by_um": 1.0, "axis": "w"}, "there is no axis 'w'"),
        ({"kind": "step", "axis": "x"}, "step takes by_um, and none of the others"),
        ({"kind": "step", "by_um": 1.0, "seconds": 3.0, "axis": "x"}, "step takes by_um, and none of the others"),
        ({"kind": "jump", "by_um": 1.0, "axis": "x"}, "kind"),
        ({"kind": "sine", "amplitude_um": 1.0, "frequency_Hz": 400.0, "seconds": 1.0, "axis": "x"}, "frequency_Hz"),
        ({"kind": "waypoints", "places_um": [1.0] * 16, "axis": "x"}, "places_um"),
        ({"kind": "waypoints", "places_um": [], "axis": "x"}, "places_um"),
        ({"number": 1}, "there is no move 1, the last is 0"),
        ({"number": 1, "by_um": 1.0}, "by_um"),
    ],
)
def test_only_what_makes_sense(cell, fields, message):
    refused(cell, message, UsageError, **fields)


def test_not_in_mode_voltage(cell):
    cell.controller.state = "READY"
    cell("set", changes={"axes.x.mode": "voltage"})
    cell.controller.state = "HOLDING"
    refused(cell, "axis x is in mode voltage", **STEP)
