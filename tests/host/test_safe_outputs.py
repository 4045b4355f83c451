"""``micromanip safe-outputs``: after whatever happened, any number of times, and never under a running controller."""

import json
import os

import pytest

from micromanip.cli.main import main
from micromanip.errors import CheckFailed, ConfigError
from micromanip.host import safe_outputs
from micromanip.io import device_lock
from micromanip.io.contract import Functions
from micromanip.io.device_lock import DeviceLocks

from .cell import SLOW, changed

TEXT = changed(SLOW, ("driver: simulated, axes: [x]", "driver: simulated, device: bench, axes: [x]"))


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path / "locks")
    file = tmp_path / "cell.yaml"
    file.write_text(TEXT)
    return file


def ended(*arguments):
    """Exit code of the command."""
    try:
        main(["safe-outputs", *map(str, arguments)])
    except SystemExit as end:
        return end.code
    return 0


class Calls:
    """Functions of a driver, in place of its C functions: notes what is called, and answers with `codes`."""

    def __init__(self, monkeypatch, **codes):
        self.made = []
        numbers = {"open": 1, "exchange": 2, "safe": 3, "close": 4}

        def call(function, context):
            name = next(name for name, number in numbers.items() if number == function)
            self.made.append(name)
            return codes.get(name, 0)

        monkeypatch.setattr(safe_outputs, "call_context", call)
        self.functions = Functions(**numbers)


@pytest.fixture
def driver(config):
    (driver,) = safe_outputs.drivers_of(config).values()
    return driver


def test_twice_does_no_harm(config, capsys):
    assert ended(config) == 0
    assert ended(config, "--json") == 0
    out = capsys.readouterr().out
    assert out.startswith("outputs at their safe value: cell\n")
    assert json.loads(out.partition("\n")[2]) == {"drivers": {"cell": {"device": "bench"}}, "failed": []}


def test_refused_while_a_controller_has_the_device(config, capsys):
    with DeviceLocks(["bench"]):
        assert ended(config) == 1
    message = capsys.readouterr().err
    assert message == (
        f"micromanip: nothing was touched: device bench is in use by another controller (process {os.getpid()}, or the "
        "loop that it left); stop it first\n"
    )


def test_an_error_elsewhere_keeps_no_output_from_its_safe_value(config):
    config.write_text(TEXT.replace("mode: voltage", "mode: sideways").replace("range_V: [-20, 150]", "range_V: 7"))
    assert ended(config) == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("drivers: {cell: {driver: simulated, device: bench, axes: [x]}}", "drivers: [1]"), r"drivers: .*mapping"),
        (("driver: simulated", "driver: simulatde"), "did you mean simulated"),
        (("device: bench", "devise: bench"), "devise"),
        (("rate_hz: 200", "rate_hz: fast"), "rate_hz"),
    ],
)
def test_configuration_that_names_no_driver(config, change, said):
    config.write_text(changed(TEXT, change))
    with pytest.raises(ConfigError, match=said):
        safe_outputs.drivers_of(config)
    assert ended(config) == 78


def test_every_driver_is_tried_and_what_failed_is_said(driver, monkeypatch):
    calls = Calls(monkeypatch, safe=7)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    assert safe_outputs.make_safe({"a": driver, "b": driver}) == [
        "driver a: its outputs could not be made safe, code 7",
        "driver b: its outputs could not be made safe, code 7",
    ]
    assert calls.made == ["open", "safe", "close"] * 2


@pytest.mark.parametrize(
    ("codes", "made", "said"),
    [
        ({"open": 5}, ["open"], "driver a could not be opened: code 5"),
        ({"close": 6}, ["open", "safe", "close"], "driver a could not be closed: code 6"),
    ],
)
def test_device_that_fails(driver, monkeypatch, codes, made, said):
    calls = Calls(monkeypatch, **codes)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    assert safe_outputs.make_safe({"a": driver}) == [said]
    assert calls.made == made


def test_failure_ends_with_69(config, driver, monkeypatch, capsys):
    calls = Calls(monkeypatch, open=5)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    assert ended(config) == 69
    assert "driver cell could not be opened: code 5" in capsys.readouterr().err
    with DeviceLocks(["bench"]), pytest.raises(CheckFailed):
        safe_outputs.make_safe({"a": driver})
