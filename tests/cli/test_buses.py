"""Configurations with a bus: the budget, and what is wrong in one line, with its place; more in the drivers' own."""

import json
import shutil

import pytest

from campaigns.report import CONFIG

from .command import code_of

SENSOR_EDS = (CONFIG / "can/sensor.eds").read_text()
DBC = (CONFIG / "can/manipulator.dbc").read_text()

BROKEN = {
    "CAN, overfull": (("can.yaml", "data_bitrate: 5000000", "data_bitrate: 1000000"), ("  can0:", "drivers.can0")),
    "CAN, no such signal": (
        ("can.yaml", "channel: Sensors.stage_x", "channel: Sensors.stgae_x"),
        ("channel: Sensors.stgae_x", "signals.stage_x"),
    ),
    "CAN, no DBC file": (
        ("can.yaml", "manipulator.dbc #", "broken.dbc #"),
        ("database: can/broken.dbc", "drivers.can0.database"),
    ),
    "CAN, one message both ways": (
        ("can.yaml", "      Voltages: {", "      Sensors: {rate_hz: 100}\n      Voltages: {"),
        ("      Sensors: {rate_hz: 100}", "drivers.can0.send.Sensors"),
    ),
    "CAN, no such interface": (
        ("can.yaml", "interface: micromanip", "interface: socketcna"),
        ("interface: socketcna", "drivers.can0.interface"),
    ),
    "CANopen, an adapter that is called simulated": (
        ("canopen.yaml", "interface: micromanip", "interface: pcan"),
        ("    simulated: true ", "drivers.can0.simulated"),
    ),
    "two drivers of one device under two names": (
        ("mixed.yaml", "tcp: {host: 127.0.0.1, port: 10001}", "tcp: {host: localhost, port: 50001}"),
        ("  amplifier:\n", "drivers.amplifier"),
    ),
    "CANopen, no EDS file": (
        ("canopen.yaml", "eds: can/sensor.eds", "eds: can/broken.eds"),
        ("eds: can/broken.eds", "drivers.can0.nodes.sensor.eds"),
    ),
    "CANopen, overfull": (("canopen.yaml", "bitrate: 1000000", "bitrate: 500000"), ("  can0:", "drivers.can0")),
}
"""Example and what is changed in it; a mark of the line that is named, and the key."""


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(CONFIG / "can", tmp_path / "can")
    (tmp_path / "can/broken.dbc").write_text(DBC.replace("BO_ 257 Sensors:", "BO_ 257 Sensors"))
    (tmp_path / "can/broken.eds").write_text(SENSOR_EDS.replace("[8130sub1]", "[8130sub1"))
    return tmp_path


@pytest.mark.parametrize(("example", "percent"), [("can.yaml", 35), ("canopen.yaml", 63)])
def test_the_examples_are_good_and_their_budget_is_shown(example, percent, capsys):
    assert code_of("check", CONFIG / example, "--json") == 0
    [load] = json.loads(capsys.readouterr().out)["buses"]["can0"]
    assert load["name"] == "can0"
    assert load["share_percent"] == pytest.approx(percent, abs=0.5)
    assert load["limit_percent"] == 80


@pytest.mark.parametrize("name", BROKEN)
def test_one_line_with_file_line_and_key(folder, name, capsys):
    (example, old, new), (marker, key) = BROKEN[name]
    text = (CONFIG / example).read_text()
    assert old in text
    file = folder / example
    file.write_text(text.replace(old, new, 1))
    line = 1 + file.read_text()[: file.read_text().rindex(marker)].count("\n")
    for command in ("check", "run"):
        assert code_of(command, file) == 78
        out, err = capsys.readouterr()
        assert err.startswith(f"micromanip: {file}:{line}: {key}: ")
        assert (err.count("\n"), out) == (1, "")
