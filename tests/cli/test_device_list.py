"""``micromanip device list``: what is installed, good or not, with its reason."""

import json
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from micromanip.bus import registry
from tests.cli import command
from tests.cli.command import code_of

LAG_STAGE = Path(__file__).parents[2] / "docs" / "examples" / "lag_stage" / "cell.yaml"
THEIRS = """
import numpy as np
from pydantic import BaseModel, ConfigDict
from micromanip.driver import Compiler, CyclicDriver, Functions, entries

compiled = Compiler(__file__)
CONTEXT = np.dtype([("V", "f8")])

@compiled
def exchange(c, outputs, inputs, now_ns, periods):
    return c["unknown"]

@compiled
def rest(c):
    return 0

ENTRIES = entries(compiled, CONTEXT, rest, exchange, rest, rest)

class Options(BaseModel):
    model_config = ConfigDict(extra="forbid")

class Stage(CyclicDriver):
    Options = Options
    simulated = True
    inputs, outputs = ("strain",), ("voltage",)

    def __init__(self, options, period_ns):
        pass

    def context(self):
        return {context}

    def functions(self):
        return Functions(*ENTRIES.addresses)
"""


@pytest.mark.parametrize(
    ("context", "line", "says"),
    [
        ("np.zeros(1, CONTEXT)[1]", 31, "IndexError: index 1 is out of bounds"),
        ("np.zeros(1, CONTEXT).view(np.uint8)", 11, "[A-Za-z]+: .*unknown"),
    ],
)
def test_what_a_driver_of_others_does_wrong_is_told_as_its_author_s(context, line, says, monkeypatch, tmp_path, capsys):
    """Also where the compiler refuses it: that was a page of numba's, and a bug to be reported to us."""
    name = f"their_stage_{line}"
    (tmp_path / f"{name}.py").write_text(THEIRS.replace("{context}", context))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    point = EntryPoint("their_stage", f"{name}:Stage", "micromanip.drivers")
    monkeypatch.setattr("micromanip.bus.registry.entry_points", lambda **_: [point])
    cell = tmp_path / "cell.yaml"
    cell.write_text(LAG_STAGE.read_text().replace("lag_stage, um_per_V: 0.9, lag_ms: 0.5", "their_stage"))
    assert command.code_of("check", cell) == 70
    told = capsys.readouterr().err
    assert re.search(rf"bug of the driver their_stage \({name}:Stage\), \S*{name}.py:{line}: {says}", told)
    assert "report it to the driver's author" in told
    assert len([said for said in told.splitlines() if not said.startswith("compiling ")]) == 2


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
    everything = registry.installed

    def choose(*names):
        monkeypatch.setattr(registry, "installed", lambda: {name: everything()[name] for name in names})

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
