"""A `safe` that can't be sent, or that lies outside of its range, is refused by every driver: it would move a stage."""

import re
import shutil

import pytest

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.settings.wiring.single_driver import driver_to_probe

VOLTAGE = re.compile(r"(voltage_x: \{(?!driver)[^}]*)\}")
"""Keys of an output in the section of its driver."""


@pytest.mark.parametrize(
    ("name", "driver", "keys", "said"),
    [
        ("ethercat.yaml", "cell", "safe: 151", "safe 151 is outside of the range -20 to 150"),
        ("ethercat.yaml", "cell", "safe: -20.5", "safe -20.5 is outside of the range -20 to 150"),
        ("ethercat.yaml", "cell", "offset: 1.0e+7", "safe 0 can't be sent: the number holds"),
        ("udp.yaml", "cell", "safe: 151", "safe 151 is outside of the range -20 to 150"),
        ("udp.yaml", "cell", "offset: 1.0e+7", "safe 0 can't be sent: the number holds"),
        ("serial.yaml", "board", "safe: 151", "safe 151 is outside of the range -20 to 150"),
        ("serial.yaml", "board", "offset: 170", "safe 0 can't be sent: the number holds 6.16 to 333.835"),
        ("gcs.yaml", "piezo", "safe: 121", "safe 121 is outside of the range -20 to 120"),
        ("modbus.yaml", "modbus", "range: [-20, 150], safe: 151", "safe 151 is outside of the range -20 to 150"),
        ("modbus.yaml", "modbus", "safe: 164", "safe 164 can't be sent: the number holds -163.84 to 163.835"),
        ("canopen.yaml", "can0", "safe: 164", "voltage_x is 164, it may be -20 to 150"),
    ],
)
def test_a_safe_value_that_can_not_be_sent_is_refused_at_its_line(tmp_path, name, driver, keys, said):
    shutil.copytree(CONFIG, tmp_path, dirs_exist_ok=True)
    file = tmp_path / name
    text, count = VOLTAGE.subn(rf"\1, {keys}}}", file.read_text(encoding="utf-8"))
    assert count == 1
    driver_to_probe(CONFIG / name, driver)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as problem:
        driver_to_probe(file, driver)
    number = next(k for k, line in enumerate(text.splitlines(), 1) if keys in line)
    message = str(problem.value)
    assert message.startswith(f"{file}:{number}: drivers.{driver}.")
    assert "voltage_x" in message
    assert said in message
    assert problem.value.exit_code == 78
