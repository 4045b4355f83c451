"""What a configuration may say, and what is said of those that can't work."""

import copy
import re
from pathlib import Path

import pytest
import yaml
from micromanip_drivers.line.driver import Line

from micromanip.errors import ConfigError
from micromanip.settings.wiring.single_driver import driver_to_probe

from ..changed_options import DELETE, put
from .board import FRAMING
from .gcs_controller import FRAMING as GCS
from .sensors import SENSOR

BOARD = {"serial": {"device": "/dev/ttyUSB0", "baud": 4_000_000}, **FRAMING}
PIEZO = {"tcp": {"host": "192.168.0.10", "port": 50000}, **GCS}
GAP = {"tcp": {"host": "192.168.0.30", "port": 10001}, **SENSOR}


def built(options):
    return Line(Line.Options.model_validate(options), None)


def test_the_examples_of_the_documentation_work():
    page = Path(__file__).parents[3] / "docs" / "line.md"
    drivers = {}
    for block in re.findall(r"```yaml\n(.*?)```", page.read_text(), re.S):
        for name, keys in yaml.safe_load(block)["drivers"].items():
            assert keys.pop("driver") == "line"
            drivers[name] = built(keys)
    assert set(drivers) == {"board", "piezo", "amplifier", "tracker"}
    (one,) = drivers["board"].loads()
    assert f"{one.name} {100 * one.share:.0f} % of 80 %: {one.detail}" in page.read_text()


def changed(options, path, value):
    """The options with another value at a path such as "binary.crc.name"; None takes the key away."""
    options = copy.deepcopy(options)
    put(options, path.split("."), DELETE if value is None else value)
    return options


REFUSED = [
    (BOARD, "serial", None, "give one port, serial, tcp or udp; there is none"),
    (BOARD, "tcp", PIEZO["tcp"], "give one port, serial, tcp or udp; there are serial and tcp"),
    (BOARD, "binary.sync", "aa 5", '"aa 5" is not hexadecimal'),
    (BOARD, "binary.crc.name", "crc8.smbuss", "there is no checksum crc8.smbuss; did you mean crc8.smbus?"),
    (BOARD, "binary.receive.strains.fields.strain_x.type", "in32", "there is no type in32; did you mean int32?"),
    (BOARD, "binary.receive.strains.fields.strain_x.byte_order", None, "byte_order must be given for int32"),
    (BOARD, "binary.receive.strains.fields.strain_x.scale", 0.0, "a scale of 0 makes every value the same"),
    (
        BOARD,
        "binary.receive.strains.fields.strain_y.at",
        9,
        "strain_x (bytes 7 to 10) and fields.strain_y (from byte 9) overlap",
    ),
    (BOARD, "binary.receive.strains.bytes", 19, "binary.receive.strains: fields.strain_z (bytes 15 to 18) and its CRC"),
    (BOARD, "binary.receive.strains.kind", None, "binary.receive.strains.kind: is missing"),
    (BOARD, "binary.send.voltages.kind", 256, "drivers.one.binary.send.voltages.kind: 256 does not fit into uint8"),
    (BOARD, "binary.send.voltages.reply", "state", "binary.receive has no state; it has strains"),
    (
        BOARD,
        "binary.send.voltages.cyclic_safe",
        False,
        "binary.send.voltages.cyclic_safe: 1000 writes per second wear out",
    ),
    (BOARD, "binary.send.voltages.fields.voltage_x.safe", 200.0, "safe 200 is outside of the range -20 to 150"),
    (BOARD, "binary.send.voltages.fields.voltage_x.range", [200.0, 300.0], "safe 0 is outside of the range"),
    (PIEZO, "ascii.write.voltages.cyclic_safe", None, "cyclic_safe: 100 writes per second wear out"),
    (PIEZO, "ascii.identity", "(", "ascii.identity.pattern: '(' is not a regular expression"),
    (
        PIEZO,
        "ascii.read.strains",
        {"request": "P?", "reply": ["{x}"], "rate_hz": 1, "fields": {"y": {}}},
        "{x} is not one",
    ),
    (GAP, "stream.fields.strain_y.at", 2, "stream.fields: fields.strain_x (bytes 0 to 3) and fields.strain_y"),
    (GAP, "stream.block_bytes", 8, "fields.strain_z ends behind the block, which has 8 bytes"),
]


@pytest.mark.parametrize(("options", "path", "value", "words"), REFUSED, ids=[f"{row[1]}={row[2]}" for row in REFUSED])
def test_refused_with_one_message_that_says_where(tmp_path, options, path, value, words):
    file = tmp_path / "cell.yaml"
    section = changed(options, path, value)
    file.write_text(yaml.safe_dump({"schema_version": 2, "drivers": {"one": {"driver": "line", **section}}}))
    with pytest.raises(ConfigError) as refusal:
        driver_to_probe(file, "one")
    lines = str(refusal.value).splitlines()
    assert len(lines) == 1
    assert re.match(rf"{re.escape(str(file))}:\d+: drivers\.one", lines[0])
    assert words in lines[0]
    assert refusal.value.exit_code == 78


@pytest.mark.parametrize(
    ("options", "section", "key"), [(BOARD, "binary.receive.strains", "rate_hz"), (GAP, "stream", "rate_hz")]
)
def test_silence_that_is_the_rule(options, section, key):
    with pytest.raises(ConfigError, match=r"silence_ms: 200 is less than two periods of what comes at .* Hz"):
        built(changed(options, f"{section}.{key}", 9.0))


def load(options):
    (one,) = built(options).loads()
    return one


def test_budget_of_a_two_wire_line():
    """RS-485 at 4 Mbaud, 8 bytes there and 24 back, 10 us of turnaround: 90 us an exchange, 11.1 kHz at most."""
    number = {"byte_order": "little"}
    options = {
        "serial": {"device": "/dev/ttyS0", "baud": 4_000_000, "rs485": {"turnaround_us": 5.0}},
        "binary": {
            "sync": "aa",
            "crc": {"name": "crc8.smbus"},
            "turnaround_us": 5.0,
            "receive": {
                "strains": {"rate_hz": 5000, "bytes": 24, "fields": {"strain": {"at": 1, "type": "int32", **number}}}
            },
            "send": {
                "voltages": {
                    "rate_hz": 5000,
                    "bytes": 8,
                    "cyclic_safe": True,
                    "reply": "strains",
                    "fields": {"voltage": {"at": 1, "type": "int16", **number}},
                }
            },
        },
    }
    one = load(options)
    assert one.name == "ttyS0"
    assert one.share == pytest.approx(5000 * 90e-6)
    assert one.detail == "5000 voltages x 90 us"


def test_rates_and_latencies():
    gap = built(GAP)
    assert {channel.rate_hz for channel in gap.inputs} == {250.0}  # of 2000 samples a second, 8 come together
    board = built(BOARD)
    assert {round(1e6 * channel.latency_s, 3) for channel in board.inputs} == {50.0}  # 20 bytes at 4 Mbaud
    assert {round(1e6 * channel.latency_s, 3) for channel in board.outputs} == {32.5}
    assert [task.name for task in board.tasks] == ["voltages"]
    assert board.watchdog == "at rest 5 ms after 10 ms of silence"
    assert board.device == "/dev/ttyUSB0"
    assert built(changed(BOARD, "watchdog", None)).watchdog is None
