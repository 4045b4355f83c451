"""`new`: what it prints is read by `check`, which asks for just what nobody but the engineer knows."""

import re

import pytest

from .command import code_of

DRIVERS = ("canbus", "canopen", "ethercat", "line", "line_binary", "modbus", "simulated", "udp")
ASKED = {"range_V", "slew_V_per_ms", "centre_um", "range_um"}
RANGES = ", range_V: [-20, 120], slew_V_per_ms: 10}"
SETPOINT = "    centre_um: 50\n    setpoint: {range_um: [5, 95]}"
LEFT = re.compile(r"device\.(dbc|eds)|watchdog|would be busy for")
"""What lies beside the file of who has the device, and what the device does without its controller."""
ADDED = 2
"""Lines that the data sheet takes: the working point, the device's watchdog."""


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
    assert text.count("\n") + ADDED <= 30
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


@pytest.mark.parametrize("rate_hz", ["100", "250", "1000", "10000"])
@pytest.mark.parametrize("driver", DRIVERS)
def test_stage_sensors_and_a_tracker_are_wired_where_they_are_asked_for(driver, rate_hz, printed, tmp_path, capsys):
    text = printed("--driver", driver, "--axes", "x,y,z", "--stage", "--tracker", "--rate", rate_hz)
    for name in ("strain", "stage", "deviation"):
        assert re.findall(rf"^  {name}_(\w): ", text.partition("signals:")[2], re.MULTILINE) == ["x", "y", "z"]
    (tmp_path / "cell.yaml").write_text(filled(text))
    code, said = code_of("check", tmp_path / "cell.yaml"), capsys.readouterr()
    assert code == 0 or all(LEFT.search(line) for line in said.err.splitlines()), said.err


@pytest.mark.parametrize(("rate_hz", "watchdog_ms"), [("100", 40), ("1000", 20)])
def test_a_watchdog_outlasts_writes_that_are_late(rate_hz, watchdog_ms, printed):
    assert f"watchdog_ms: {watchdog_ms} " in printed("--driver", "canopen", "--rate", rate_hz)


@pytest.mark.parametrize(
    ("driver", "wired"),
    [("modbus", "serial: {device: /dev/ttyUSB0,"), ("line", "serial: {device: /dev/ttyUSB0,"), ("canbus", "slcan ")],
)
def test_a_path_is_a_serial_port(driver, wired, printed):
    assert wired in printed("--driver", driver, "--address", "/dev/ttyUSB0")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("--driver", "gcs"), "did you mean line?"),
        (("--driver", "modbus", "--axes", "x y"), "'x y' is no name of an axis"),
        (("--driver", "modbus", "--address", "10.0.0.7:abc"), "10.0.0.7:502"),
        (("--driver", "simulated", "--probe"), "has no bus to look at"),
    ],
)
def test_what_is_mistyped_is_told_with_what_would_be_right(wrong, said, capsys):
    assert code_of("new", *wrong) == 64
    assert said in capsys.readouterr().err


def test_what_comes_with_the_program_is_listed(printed):
    text = printed("--list")
    assert text.startswith(f"drivers: {', '.join(DRIVERS)}\n")
    assert "config/modbus.yaml" in text
