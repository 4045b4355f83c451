"""What a played device is told by lines of JSON, and what a controller on the bus then sees."""

import json

import pytest


def order(controller, **command):
    assert controller.order(json.dumps(command)) == {"ok": True}


def course(controller, signal, seconds):
    """What the bus says of a signal in the next seconds."""
    controller.heard.clear()
    controller.run(seconds)
    return [values[signal] for _, values in controller.decoded("Sensors")]


def test_freeze_lasts_its_time_while_the_counter_runs(controller):
    controller.command_for(0.02)
    order(controller, device="freeze", signal="stage_x", for_s=0.05)
    controller.heard.clear()
    controller.command_for(0.045, voltage_x=50.0)
    frozen = controller.decoded("Sensors")
    assert len({values["stage_x"] for _, values in frozen}) == 1
    assert len({values["strain_x"] for _, values in frozen}) > 50
    assert len({values["Count"] for _, values in frozen}) == len(frozen)
    controller.command_for(0.05, voltage_x=50.0)
    assert controller.newest()["stage_x"] > frozen[0][1]["stage_x"] + 10.0


def test_offset_and_drift(controller):
    controller.run(0.01)
    before = controller.newest()["strain_x"]
    order(controller, device="offset", signal="strain_x", value=7.5)
    assert course(controller, "strain_x", 0.01)[-1] == pytest.approx(before + 7.5, abs=0.01)
    order(controller, device="drift", signal="strain_x", per_s=100.0)
    drifting = course(controller, "strain_x", 0.1)
    assert drifting[-1] - before == pytest.approx(10.0, abs=0.2)
    assert drifting[100] - before == pytest.approx(5.0, abs=0.2)
