"""`new`: what it prints is read by `check`, which asks for just what nobody but the engineer knows."""

import re

import pytest

from .command import code_of

DRIVERS = ("canbus", "canopen", "ethercat", "line", "modbus", "simulated", "udp")
ASKED = {"range_V", "slew_V_per_ms", "centre_um", "range_um"}
RANGES = ", range_V: [-20, 120], slew_V_per_ms: 10}"
SETPOINT = "    centre_um: 50\n    setpoint: {range_um: [5, 95]}"
LEFT = re.compile(r"device\.(dbc|eds)|watchdog")
"""What lies beside the file of who has the device, and what the device does without its controller."""


@pytest.fixture
def printed(capsys):
    def typed(*arguments):
        assert code_of("new", *arguments) == 0
        return capsys.readouterr().out

    return typed


def filled(text):
    """With what a data sheet says."""
    lines = []
    for line in text.splitlines():
        if line.startswith("  voltage_") and "range_V" not in line:
            line = line.removesuffix("}") + RANGES
        if line.startswith("    setpoint: {} "):
            line = SETPOINT
        lines.append(line)
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_small_configuration_asks_for_what_only_a_person_knows(driver, printed, tmp_path, capsys):
    text, file = printed("--driver", driver, "--axes", "z"), tmp_path / "cell.yaml"
    assert text.count("\n") <= 30
    file.write_text(text)
    code = code_of("check", file)
    said = capsys.readouterr().err
    if driver == "simulated":
        assert (code, said) == (0, "")
        return
    assert code == 78
    assert {re.search(r"\.(\w+): missing", line)[1] for line in said.splitlines()} == ASKED
    file.write_text(filled(text))
    code, said = code_of("check", file), capsys.readouterr()
    assert code == 0 or all(LEFT.search(line) for line in said.err.splitlines()), said.err


def test_each_axis_has_channels_and_registers_of_its_own(printed):
    text = printed("--driver", "modbus", "--axes", "x,y,z", "--address", "10.0.0.7")
    assert re.findall(r"strain_(\w): \{address: (\d+)", text) == [("x", "0"), ("y", "2"), ("z", "4")]
    assert re.findall(r"voltage_(\w): \{address: (\d+)", text) == [("x", "100"), ("y", "101"), ("z", "102")]
    assert "host: 10.0.0.7" in text


def test_what_comes_with_the_program_is_listed(printed):
    text = printed("--list")
    assert text.startswith(f"drivers: {', '.join(DRIVERS)}\n")
    assert "config/modbus.yaml" in text
