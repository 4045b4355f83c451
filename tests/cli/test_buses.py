"""Configurations with a bus: the budget, and what is wrong in one line, with its place and what would be right."""

import json
import re
import shutil
from pathlib import Path

import pytest

from micromanip.cli.main import main
from tests.further import further

from .command import code_of

CONFIG = Path(__file__).parents[2] / "config"
SENSOR_EDS = (CONFIG / "can/sensor.eds").read_text()
DBC = (CONFIG / "can/manipulator.dbc").read_text()

BROKEN = {
    "CAN, overfull": (
        ("can.yaml", "data_bitrate: 5000000", "data_bitrate: 1000000"),
        "  can0:",
        "drivers.can0: can0 would be busy for 110 % of the time",
        "use a faster bus",
    ),
    "CAN, no such file": (
        ("can.yaml", "manipulator.dbc #", "manipulater.dbc #"),
        "database: can/manipulater",
        "drivers.can0.database: ",
        "can't be read: No such file",
    ),
    "CAN, no such message": (
        ("can.yaml", "      Sensors: {", "      Sensor: {"),
        "      Sensor: {",
        "drivers.can0.receive.Sensor: manipulator.dbc has no message Sensor",
        "did you mean Sensors?",
    ),
    "CAN, no such counter": (
        ("can.yaml", "Voltages: {rate_hz: 2000, counter: Count", "Voltages: {rate_hz: 2000, counter: Cuont"),
        "counter: Cuont",
        "drivers.can0.send.Voltages.counter: Voltages has no signal Cuont",
        "did you mean Count?",
    ),
    "CAN, no such signal": (
        ("can.yaml", "channel: Sensors.stage_x", "channel: Sensors.stgae_x"),
        "channel: Sensors.stgae_x",
        "signals.stage_x: driver can0 has no channel Sensors.stgae_x",
        "did you mean Sensors.stage_x?",
    ),
    "CAN, no DBC file": (
        ("can.yaml", "manipulator.dbc #", "broken.dbc #"),
        "database: can/broken.dbc",
        "drivers.can0.database: ",
        "is not a DBC file: Invalid syntax at line ",
    ),
    "CAN, two messages on one identifier": (
        ("can.yaml", "manipulator.dbc #", "twin.dbc #"),
        "      Sensors: {",
        "drivers.can0.receive.Sensors: Sensors and Tracker both have the identifier 0x101 in twin.dbc",
        "frames can't be told apart",
    ),
    "CAN, one message both ways": (
        ("can.yaml", "      Voltages: {", "      Sensors: {rate_hz: 100}\n      Voltages: {"),
        "      Sensors: {rate_hz: 100}",
        "drivers.can0.send.Sensors: Sensors is received already",
        "a message has one sender",
    ),
    "CAN, no such interface": (
        ("can.yaml", "interface: micromanip", "interface: socketcna"),
        "interface: socketcna",
        "drivers.can0.interface: python-can has no interface socketcna",
        "did you mean socketcan?",
    ),
    "CAN, a real interface that is called simulated": (
        (
            "can.yaml",
            "    interface: micromanip         # the test bus that simulate-device keeps\n    channel: can0",
            "    interface: socketcan\n    channel: lo",
        ),
        "    simulated: true ",
        "drivers.can0.simulated: lo is no virtual interface: it may move a real stage",
        "take simulated away",
    ),
    "CANopen, an adapter that is called simulated": (
        ("canopen.yaml", "interface: micromanip", "interface: pcan"),
        "    simulated: true ",
        "drivers.can0.simulated: python-can's interface pcan leads out of this machine",
        "take simulated away",
    ),
    "serial line, a real port that is called simulated": (
        ("serial.yaml", "/tmp/micromanip-board", "/dev/ttyUSB0"),
        "    simulated: true ",
        "drivers.board.simulated: /dev/ttyUSB0 is not there, so it is not seen to be a pseudo terminal",
        "set loop.limits: hardware",
    ),
    "GCS, another machine that is called simulated": (
        ("gcs.yaml", "tcp: {host: 127.0.0.1", "tcp: {host: 192.0.2.1"),
        "    simulated: true               #",
        "drivers.piezo.simulated: 192.0.2.1 is not this machine: it may move a real stage",
        "take simulated away",
    ),
    "Modbus, another machine that is called simulated": (
        ("modbus.yaml", "tcp: {host: 127.0.0.1", "tcp: {host: no-such-host.invalid"),
        "    simulated: true ",
        "drivers.modbus.simulated: no-such-host.invalid can't be looked up",
        "take simulated away",
    ),
    "two drivers of one device under two names": (
        ("mixed.yaml", "tcp: {host: 127.0.0.1, port: 10001}", "tcp: {host: localhost, port: 50001}"),
        "  amplifier:\n",
        "drivers.amplifier: driver gap owns tcp localhost:50001 already, here called tcp 127.0.0.1:50001",
        "one driver has a device alone",
    ),
    "CANopen, overfull": (
        ("canopen.yaml", "bitrate: 1000000", "bitrate: 500000"),
        "  can0:",
        "drivers.can0: can0 would be busy for 126 % of the time",
        "use a faster bus",
    ),
    "CANopen, no such file": (
        ("canopen.yaml", "eds: can/sensor.eds", "eds: can/senser.eds"),
        "eds: can/senser.eds",
        "drivers.can0.nodes.sensor.eds: EDS file ",
        "can't be read: No such file",
    ),
    "CANopen, no EDS file": (
        ("canopen.yaml", "eds: can/sensor.eds", "eds: can/broken.eds"),
        "eds: can/broken.eds",
        "drivers.can0.nodes.sensor.eds: ",
        "broken.eds:646: ",
    ),
    "CANopen, an EDS file without an object that it maps": (
        ("canopen.yaml", "eds: can/sensor.eds", "eds: can/without.eds"),
        "          1: {rate_hz: 1000, signals: {strain_x",
        "drivers.can0.nodes.sensor.tpdo.1: ",
        "without.eds has no object 8130sub1",
    ),
    "CANopen, no such signal": (
        ("canopen.yaml", "{strain_x: {scale", "{strian_x: {scale"),
        "{strian_x: {scale",
        "drivers.can0.nodes.sensor.tpdo.1.signals.strian_x: ",
        "did you mean strain_x?",
    ),
    "CANopen, two PDOs on one identifier": (
        ("canopen.yaml", "eds: can/sensor.eds", "eds: can/twin.eds"),
        "          2: {rate_hz: 1000",
        "drivers.can0.nodes.sensor.tpdo.2: tpdo 2 of node sensor and tpdo 1 of node sensor are both on identifier ",
        "another EDS file",
    ),
    "CANopen, one number for two nodes": (
        ("canopen.yaml", "node_id: 6", "node_id: 5"),
        "        node_id: 5",
        "drivers.can0.nodes.amplifier.node_id: 5 is also that of sensor",
        "",
    ),
    "CANopen, no such interface": (
        ("canopen.yaml", "interface: micromanip", "interface: Socketcan"),
        "interface: Socketcan",
        "drivers.can0.interface: python-can has no interface Socketcan",
        "did you mean socketcan?",
    ),
}


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(CONFIG / "can", tmp_path / "can")
    (tmp_path / "can/broken.dbc").write_text(DBC.replace("BO_ 257 Sensors:", "BO_ 257 Sensors"))
    (tmp_path / "can/twin.dbc").write_text(re.sub(r"(BO_|SG_|VAL_) 272 ", r"\1 257 ", DBC))
    (tmp_path / "can/broken.eds").write_text(SENSOR_EDS.replace("[8130sub1]", "[8130sub1"))
    (tmp_path / "can/without.eds").write_text(re.sub(r"\[8130sub1\].*?\n\n", "", SENSOR_EDS, flags=re.DOTALL))
    (tmp_path / "can/twin.eds").write_text(SENSOR_EDS.replace("$NODEID+0x280", "$NODEID+0x180"))
    return tmp_path


@pytest.mark.parametrize(("example", "percent"), [("can.yaml", 35), ("canopen.yaml", 63)])
def test_the_examples_are_good_and_their_budget_is_shown(example, percent, capsys):
    main(["check", str(CONFIG / example), "--json"])
    [load] = json.loads(capsys.readouterr().out)["buses"]["can0"]
    assert load["name"] == "can0"
    assert load["share_percent"] == pytest.approx(percent, abs=0.5)
    assert load["limit_percent"] == 80


@pytest.mark.parametrize("name", BROKEN)
def test_one_line_with_place_and_way_out(folder, name, capsys):
    (example, old, new), marker, message, way_out = BROKEN[name]
    text = (CONFIG / example).read_text()
    assert old in text
    file = folder / example
    file.write_text(text.replace(old, new, 1))
    line = 1 + file.read_text()[: file.read_text().rindex(marker)].count("\n")
    for command in ("check", "run"):
        with pytest.raises(SystemExit) as ended:
            main([command, str(file)])
        said = capsys.readouterr()
        assert ended.value.code == 78
        assert said.err.startswith(f"micromanip: {file}:{line}: {message}")
        assert way_out in said.err
        assert said.err.count("\n") == 1
        assert not said.out


@pytest.mark.live
@pytest.mark.parametrize(("example", "interface"), [("can.yaml", "can97"), *further(("canopen.yaml", "can98"))])
def test_a_missing_interface_is_one_line_too(folder, example, interface, capsys):
    """Each its own: a device belongs to one controller at a time, and tests run side by side."""
    text = (CONFIG / example).read_text()
    file = folder / example
    changed = text.replace("interface: micromanip", "interface: socketcan").replace(
        "channel: can0\n", f"channel: {interface}\n"
    )
    file.write_text(changed)
    line = 1 + changed[: changed.index("  can0:")].count("\n")
    assert code_of("run", file, "--socket", folder / "s") == 69
    out, err = capsys.readouterr()
    assert err.startswith(
        f"micromanip: {file}:{line}: drivers.can0: socketcan-{interface}: "
        f"there is no network interface {interface}; CAN interfaces"
    )
    assert err.count("\n") == 1
    assert not out
