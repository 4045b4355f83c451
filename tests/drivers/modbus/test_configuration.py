"""What a configuration may say, and the one message for each that can't work."""

import copy
import re
from pathlib import Path

import pytest
import yaml
from micromanip_drivers.modbus.driver import Modbus

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare
from micromanip.settings.wiring.buses import bus_findings
from micromanip.settings.wiring.single_driver import driver_to_probe

from ..changed_options import DELETE, put

FILES = ["modbus.yaml", "modbus_rtu.yaml"]
UNIT = "units.cell.tasks.exchange."


def entry(text):
    return next(iter(yaml.safe_load(text)["drivers"].values()))


def changed(path, value):
    """The driver of config/modbus.yaml with one key changed; DELETE takes it away."""
    keys = entry((CONFIG / "modbus.yaml").read_text(encoding="utf-8"))
    keys = copy.deepcopy(keys)
    put(keys, path.split("."), value)
    return keys


def told(tmp_path, keys):
    """What is said of a driver with such keys, without the name of the file."""
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump({"drivers": {"modbus": keys}}, sort_keys=False), encoding="utf-8")
    with pytest.raises(ConfigError) as problem:
        driver_to_probe(file, "modbus")
    assert problem.value.exit_code == 78
    text = str(problem.value)
    assert text.startswith(f"{file}:")
    line, said = text.removeprefix(f"{file}:").split(": ", 1)
    there = file.read_text(encoding="utf-8").splitlines()[int(line) - 1].split(":")[0].strip()
    assert there in said.split(": ")[0].split("."), "the line is that of the key, or of the section that it misses"
    assert "\n" not in said, "one message"
    return said


def test_the_example_of_the_documentation_works():
    page = Path(__file__).parents[3] / "docs" / "modbus.md"
    keys = entry(page.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0])
    del keys["driver"]
    driver = Modbus(Modbus.Options.model_validate(keys), None)
    assert [channel.name for channel in driver.inputs] == ["gauge.strain_x", "gauge.strain_y"]
    assert driver._plans[0].exchanges[0].request({}).hex() == "03003f0004"


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (
            f"{UNIT}read.strain_x.type",
            "int31",
            "expected int16, uint16, int32, .* not the text .int31.: did you mean int32",
        ),
        (f"{UNIT}read.strain_x.address", 1, "registers?.*strain_y.*overlap|strain_.: overlaps with .*strain_."),
        (f"{UNIT}read.enable.first_bit", 1, "overlaps with .*bit 1 of register 18"),
        (f"{UNIT}write.voltage_x.cyclic_safe", False, "cyclic_safe: .*not marked safe.*flash"),
        (f"{UNIT}write.voltage_x.address", 110, "function 23 carries one block"),
        (f"{UNIT}function", 16, "read: function 16 can't read"),
        (f"{UNIT}read.strain_x.scale", 0.0, "scale: a scale of 0 makes every value the same"),
        ("units.cell.address_base", 19, "address 0 with address_base 19 would be -19 on the wire"),
        ("units.cell.byte_order", DELETE, "byte_order: missing"),
        ("tcp", DELETE, "exactly one of tcp: .* and serial: .*neither is there"),
        ("timeout_ms", 0.5, "timeout_ms: 0.5 ms is over before cell.exchange can be answered"),
    ],
)
def test_what_can_not_work(tmp_path, path, value, said):
    found = told(tmp_path, changed(path, value))
    assert re.search(said, found), found


def test_units_on_a_serial_line_have_numbers_of_it(tmp_path):
    keys = changed("tcp", DELETE) | {"serial": {"device": "/dev/ttyUSB0", "baud": 115200}, "timeout_ms": 30}
    keys["units"]["cell"]["unit_id"] = 255
    assert "on a serial line units go from 1 to 247, not 255" in told(tmp_path, keys)
    keys["units"]["cell"]["unit_id"] = 1
    keys["serial"]["bytesize"] = 7
    assert "Modbus RTU has 8 data bits, not 7" in told(tmp_path, keys)


@pytest.mark.parametrize("name", FILES)
def test_the_examples_fit_their_lines(name):
    prepared = prepare(CONFIG / name)
    assert not list(bus_findings(prepared.configuration, prepared.wiring))


def test_what_a_line_can_not_carry_is_refused(tmp_path):
    text = (CONFIG / "modbus_rtu.yaml").read_text(encoding="utf-8")
    file = tmp_path / "cell.yaml"
    assert "rate_hz: 100\n" in text
    file.write_text(text.replace("rate_hz: 100\n", "rate_hz: 125\n"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"would be busy for 1?\d\d % of the time .* at most 90 %"):
        prepare(file)


def test_the_budget_of_a_serial_line_worked_out_by_hand():
    """115200 baud, 8 data bits, no parity: FC23 with 12 registers read and 6 written, 1 ms to think."""
    read = {f"r{i}": {"address": i, "type": "int16"} for i in range(12)}
    write = {f"w{i}": {"address": i, "type": "int16", "cyclic_safe": True} for i in range(6)}
    tasks = {"x": {"function": 23, "rate_hz": 100, "read": read, "write": write}}
    unit = {"unit_id": 1, "address_base": 0, "byte_order": "big", "word_order": "big", "tasks": tasks}
    keys = {"serial": {"device": "/dev/x", "baud": 115200}, "timeout_ms": 30, "response_ms": 1, "units": {"u": unit}}
    driver = Modbus(Modbus.Options.model_validate(keys), None)
    (load,) = driver.loads()
    request, answer = (1 + 10 + 12 + 2) * 10 / 115200, (1 + 2 + 24 + 2) * 10 / 115200
    assert load.share == pytest.approx(100 * (request + answer + 1e-3 + 2 * 1.75e-3))
    assert load.limit == 0.9
    assert driver.inputs[0].latency_s == pytest.approx(answer + 0.5e-3)
    assert driver.outputs[0].latency_s == pytest.approx(request + 0.5e-3)
