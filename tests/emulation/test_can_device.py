"""The device on CAN as a foreign controller sees it."""

import numpy as np
import pytest

from .emulated import CONFIG, Controller, configuration

STEP_UM = 1e-4
"""Resolution of the sensors in the DBC."""


def test_messages_come_at_their_rates_and_count(controller):
    controller.run(0.5)
    for name, rate_hz in (("Sensors", 2000), ("Tracker", 1000)):
        heard = controller.decoded(name)
        assert len(heard) == pytest.approx(0.5 * rate_hz, abs=1)
        counts = [values["Count"] for _, values in heard]
        assert counts == list(range(len(counts)))
        gaps_us = np.diff([time_ns for time_ns, _ in heard]) * 1e-3
        assert abs(gaps_us - 1e6 / rate_hz).max() < 150.0, "a frame waits for one other at most"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_a_database_that_another_program_has_saved(tmp_path, closing, encoding):
    """Whatever the driver takes, and a message of others in it that makes no sense."""
    text = (CONFIG / "can/manipulator.dbc").read_text()
    odd = 'BO_ 999 Odd: 1 Device\n SG_ a : 0|16@1+ (1,0) [0|0] "µm" Controller\n'
    saved = text.replace("\nBO_ 272", f"\n{odd}\nBO_ 272").replace("\n", "\r\n") + "\x1a"
    (tmp_path / "saved.dbc").write_bytes(saved.encode(encoding))
    controller = closing(Controller(configuration(tmp_path, (f"{CONFIG}/can/manipulator.dbc", "saved.dbc"))))
    controller.run(0.01)
    assert controller.newest()["enable"] == 1


def test_frames_hold_what_the_plant_measures(controller):
    controller.command_for(0.05, voltage_x=40.0, voltage_y=20.0, voltage_z=90.0)
    plant = controller.devices.cell.plant
    controller.run(0.0004)
    values = controller.newest()
    for name in ("strain_x", "strain_y", "strain_z", "stage_x", "stage_y", "stage_z"):
        assert values[name] == pytest.approx(plant.value(name), abs=STEP_UM), name
    assert values["strain_z"] > values["strain_x"] > values["strain_y"] > 5.0
    assert values["enable"] == values["interlock"] == values["amplifier_ok_y"] == values["temperature_ok_z"] == 1
    assert values["retracted"] == values["Status"] == 0
    assert controller.newest("Tracker")["deviation_y"] == pytest.approx(plant.value("deviation_y"), abs=5e-4)


def test_watchdog_over_the_bus(controller):
    controller.command_for(0.1, voltage_x=60.0)
    assert controller.newest()["amplifier_ok_x"] == 1
    up = controller.newest()["strain_x"]
    controller.run(0.11)
    assert controller.newest()["amplifier_ok_x"] == 0
    controller.run(0.3)
    assert controller.newest()["strain_x"] < 0.2 * up
    controller.command_for(0.05, voltage_x=60.0)
    assert controller.newest()["amplifier_ok_x"] == 0, "it waits for commands at rest"
    controller.command_for(0.01)
    controller.command_for(0.1, voltage_x=60.0)
    assert controller.newest()["amplifier_ok_x"] == 1
    assert controller.newest()["strain_x"] == pytest.approx(up, rel=0.1)


def test_late_machine_sends_every_sample_with_its_own_time(controller):
    """The loop comes 4 ms late once: no frame is missing, and the bus keeps its order."""
    controller.run(0.01)
    controller.devices.loop.time_ns += 4_000_000
    controller.run(0.066)
    heard = controller.decoded("Sensors")
    assert [values["Count"] for _, values in heard] == list(range(len(heard)))
    assert len(heard) == pytest.approx(160, abs=1)
    assert controller.order('{"report": true}')["devices"]["can0"]["not_sent"] == 0


def test_a_stall_beyond_that_leaves_frames_out_and_says_so(controller):
    controller.run(0.01)
    controller.devices.loop.time_ns += 505_000_000  # 5 ms can be made up for
    controller.run(0.01)
    figures = controller.order('{"report": true}')
    assert figures["devices"]["can0"]["not_sent"] == pytest.approx(1500, abs=10)
    counts = [values["Count"] for _, values in controller.decoded("Sensors")]
    assert max(np.diff(counts)) == pytest.approx(1000, abs=10), "the controller can't tell that samples are missing"
    assert figures["stalls"]["count"] == 1
    assert figures["stalls"]["longest_ms"] == pytest.approx(500, abs=60)
    assert figures["stalls"]["latest_ms"] == figures["stalls"]["longest_ms"]
    assert controller.order('{"report": true}')["stalls"]["latest_ms"] == 0.0
