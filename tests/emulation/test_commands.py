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


def test_stopped_counter_with_running_values(controller):
    order(controller, device="stop_counter", message="Sensors", for_s=0.02)
    controller.command_for(0.015, voltage_x=50.0)
    heard = controller.decoded("Sensors")
    assert len({values["Count"] for _, values in heard}) == 1
    assert len({values["strain_x"] for _, values in heard}) > 10
    assert controller.newest("Tracker")["Count"] > 10
    controller.run(0.01)
    assert controller.newest()["Count"] > heard[-1][1]["Count"]


def test_reboot_is_silent_and_deaf_then_begins_anew(controller):
    controller.command_for(0.1, voltage_x=50.0)
    order(controller, device="reboot", for_s=0.3)
    controller.run(0.001)
    controller.heard.clear()
    controller.command_for(0.295, voltage_x=50.0)
    assert not controller.heard
    controller.command_for(0.02, voltage_x=50.0)
    first = controller.decoded("Sensors")[0][1]
    assert first["Count"] == 0
    assert first["amplifier_ok_x"] == 0
    assert abs(first["strain_x"]) < 10.0, "the outputs went to rest meanwhile"


def test_report_tells_what_came_since_the_last(controller):
    controller.command_for(0.02, voltage_x=10.0)
    assert controller.order('{"report": true}')["outputs"]["voltage_x"]["max"] == pytest.approx(10.0, abs=0.003)
    controller.command_for(0.02, voltage_x=4.0)
    report = controller.order('{"report": true}')
    x = report["outputs"]["voltage_x"]
    assert x["max"] == pytest.approx(4.0, abs=0.003)
    assert x["largest_step_V"] == pytest.approx(6.0, abs=0.006)
    assert x["samples"] == 20
    assert report["path_error_um"]["x"]["rms"] > 0.0
    assert report["devices"]["can0"]["bus_load_percent"] == pytest.approx(39, abs=10)
    assert controller.devices.report()["outputs"]["voltage_x"]["max"] == pytest.approx(10.0, abs=0.003)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("freeze", "not a line of JSON"),
        ("[1]", "not a JSON object"),
        ('{"devise": "freeze"}', 'a command is {"device": ...}, {"inject": ...} or {"report": true}'),
        ('{"device": "freez"}', "did you mean freeze?"),
        ('{"device": "freeze", "signal": "strain_w"}', "no device sends a signal strain_w; there are strain_x"),
        ('{"device": "silence", "message": "Sensor"}', "no device sends a message Sensor; there are Sensors, Tracker"),
        ('{"device": "offset", "signal": "strain_x"}', "value: missing"),
        ('{"device": "drift", "signal": "strain_x", "per_ms": 1}', "did you mean per_s"),
        ('{"device": "reboot", "for_s": -1}', "for_s: expected a number from 1e-06 to 86400"),
        ('{"device": "reboot", "driver": "can1"}', "no driver can1 is emulated; there are can0"),
        ('{"inject": "dropp"}', "dropp"),
        ('{"inject": "drop", "driver": "can1"}', "no driver can1 is emulated"),
    ],
)
def test_what_can_not_be_done_is_answered_in_one_sentence(controller, line, said):
    answer = controller.order(line)
    assert said in answer["error"]
    assert "\n" not in answer["error"]
