"""``micromanip device list``: what is installed, good or not, with its reason."""

import json

import pytest

from micromanip.bus import inspection

from .command import code_of

BUS = '''
from micromanip.bus.driver import BusDriver, BusOptions
class Driver(BusDriver):
    """A driver of nothing."""
    Options = BusOptions
    version = "7.7"
    device, watchdog, inputs, outputs, tasks = "nothing", None, (), (), ()
    def __init__(self, options, folder): ...
    def loads(self): return []
    def open(self): ...
    def perform(self, task, values, inbox): ...
    def close(self): ...
'''


@pytest.fixture
def only(monkeypatch):
    """Hide all drivers but those named."""
    everything = inspection.installed

    def choose(*names):
        monkeypatch.setattr(inspection, "installed", lambda: {name: everything()[name] for name in names})

    return choose


def listed(capsys, *arguments):
    """Exit code, and what is on standard output and error."""
    return code_of("device", "list", *arguments), *capsys.readouterr()


def test_good_ones_of_both_kinds(announce, only, capsys):
    announce("nothing", "driver_of_nothing:Driver", BUS)
    only("nothing", "simulated")
    code, out, _ = listed(capsys, "--json")
    assert code == 0
    nothing, simulated = json.loads(out)["drivers"]
    assert nothing.pop("file").endswith("driver_of_nothing.py")
    assert nothing == {
        "name": "nothing",
        "kind": "bus",
        "package": "nothing-package",
        "version": "7.7",
        "entry_point": "driver_of_nothing:Driver",
        "problems": [],
        "ok": True,
    }
    assert (simulated["name"], simulated["kind"], simulated["package"]) == ("simulated", "cyclic", "micromanip")
    code, out, _ = listed(capsys)
    assert code == 0
    assert "nothing    bus     loads   nothing-package 7.7" in out


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "can't be loaded: ModuleNotFoundError: No module named 'driver_of_nothing'"),
        ("raise SystemExit(0)", "can't be loaded: SystemExit: 0"),
        ("1 / 0", "can't be loaded: ZeroDivisionError"),
        ("import sys; Driver = 5", "is not a class derived from micromanip.driver.CyclicDriver or"),
        (BUS.replace("def close", "def shut"), "does not have close"),
        (BUS.replace('"""A driver of nothing."""', ""), "has no docstring"),
        (BUS.replace("task, values, inbox", "task, values"), "perform does not take (task, values, inbox)"),
        (
            BUS.replace("Options = BusOptions", "class Options(BusOptions, extra='ignore'): ..."),
            "Options accepts unknown keys",
        ),
        (BUS.replace("Options = BusOptions", "Options = dict"), "Options is not a model derived from"),
        (
            BUS.replace("Options = BusOptions", "class Options(BusOptions):\n        speed: int = 3"),
            "Options does not describe speed",
        ),
    ],
)
def test_broken_one_is_shown_with_its_reason(text, reason, announce, only, capsys):
    announce("nothing", "driver_of_nothing:Driver", text)
    only("nothing", "simulated")
    code, out, err = listed(capsys)
    assert code == 1
    assert reason in out
    assert "BROKEN" in out
    assert "simulated  cyclic  loads" in out
    assert err == "micromanip: driver nothing can't be used\n"
