"""``micromanip park``: after whatever happened, any number of times, and never under a running controller."""

import json
import os
import threading

import pytest

from micromanip.bus import device_lock
from micromanip.bus.bridge import BusBridge
from micromanip.bus.cyclic import Functions
from micromanip.bus.device_lock import DeviceLocks
from micromanip.bus.driver import BusOptions
from micromanip.bus.errors import DeviceFault
from micromanip.cli.main import main
from micromanip.errors import CheckFailed
from micromanip.host.safe import outputs as safe_outputs
from micromanip.host.safe import plan as safe_plan
from micromanip.host.safe.outputs import make_safe
from micromanip.host.safe.plan import SafePlan, plan_of
from micromanip.host.safe.snapshot import write
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.places import Wiring
from tests.cells import SLOW, changed

from .test_bus_rest import OUTPUTS, RAMP_S, SAFE, Bus

TEXT = changed(SLOW, ("driver: simulated, axes: [x]", "driver: simulated, device: bench, axes: [x]"))


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path / "locks")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(safe_plan, "SERVICE_STATE", tmp_path / "service")
    file = tmp_path / "cell.yaml"
    file.write_text(TEXT)
    return file


def ended(*arguments):
    """Exit code of the command."""
    try:
        main(["park", *map(str, arguments)])
    except SystemExit as end:
        return end.code
    return 0


class Calls:
    """Functions of a driver, in place of its C functions: notes what is called, and answers with `codes`.

    Each must be given the address of the context that was opened.
    """

    def __init__(self, monkeypatch, **codes):
        self.made = []
        opened = set()
        numbers = {"open": 1, "exchange": 2, "safe": 3, "close": 4}

        def call(function, context):
            name = next(name for name, number in numbers.items() if number == function)
            self.made.append(name)
            assert isinstance(context, int)
            if name == "open":
                opened.add(context)
            assert context in opened
            return codes.get(name, 0)

        monkeypatch.setattr(safe_outputs, "call_context", call)
        self.functions = Functions(**numbers)


def planned(config, drivers, outputs=None):
    """A plan for other drivers than those of the file."""
    plan = plan_of(config)

    class Wired(Wiring):
        def safe_outputs(self, name, configuration):
            return outputs[name]

    wiring = Wired(drivers, {}, {}, {}, {}, {}, {})
    configuration = plan.configuration.model_copy(
        update={"start": plan.configuration.start.model_copy(update={"ramp_s": RAMP_S})}
    )
    return SafePlan(configuration, wiring, plan.file, plan.taken)


@pytest.fixture
def driver(config):
    (driver,) = plan_of(config).wiring.drivers.values()
    return driver


def test_twice_does_no_harm(config, capsys):
    assert ended(config) == 0
    assert ended(config, "--json") == 0
    out = capsys.readouterr().out
    said = f"outputs at their safe value: cell\nfrom {config}\n"
    assert out.startswith(said)
    assert json.loads(out.removeprefix(said)) == {
        "drivers": {"cell": {"device": "bench"}},
        "failed": [],
        "safe": ["cell"],
        "source": {"file": str(config), "taken": None},
        "warnings": [],
    }


def test_it_goes_by_what_last_ran_and_says_so(config, tmp_path, capsys):
    write(Source.read(config), {}, tmp_path / "micromanip")
    config.write_text(TEXT.replace("mode: voltage", "mode: sideways"))
    assert ended(config) == 0
    said = capsys.readouterr().out
    assert "outputs at their safe value: cell\nas of the run of 20" in said
    assert ended(config, "--json") == 0
    source = json.loads(capsys.readouterr().out)["source"]
    assert source["taken"] in said
    assert source["file"].startswith(str(tmp_path / "micromanip"))
    assert ended(config, "--from-file") == 78


def test_what_was_left_and_can_not_be_used_is_a_warning(config, tmp_path, capsys):
    write(Source.read(config), {}, tmp_path / "micromanip")
    (snapshot,) = (tmp_path / "micromanip" / "park").iterdir()
    snapshot.chmod(0o666)
    assert ended(config, "--json") == 0
    said = capsys.readouterr()
    warning = f"{snapshot} can be written by others"
    assert said.err == f"WARNING: {warning}\n"
    assert json.loads(said.out)["warnings"] == [warning]


def test_refused_while_a_controller_has_the_device(config, capsys):
    with DeviceLocks(["bench"]):
        assert ended(config) == 1
    message = capsys.readouterr().err
    assert message == (
        f"micromanip: nothing was touched: device bench is in use by another controller (process {os.getpid()}, or the "
        "loop that it left); stop it first\n"
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("drivers: {cell: {driver: simulated, device: bench, axes: [x]}}", "drivers: [1]"), "drivers: "),
        (("driver: simulated", "driver: simulatde"), "did you mean simulated"),
        (("device: bench", "devise: bench"), "devise"),
        (("rate_hz: 200", "rate_hz: fast"), "rate_hz"),
        (("mode: voltage", "mode: sideways"), "mode"),
        (("park_V: 0", "park_V: 151"), "park_V"),
    ],
)
def test_a_configuration_that_run_refuses_and_that_never_ran(config, monkeypatch, driver, capsys, change, said):
    calls = Calls(monkeypatch)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    config.write_text(changed(TEXT, change))
    assert ended(config) == 78
    message = capsys.readouterr().err
    assert said in message
    assert "nothing was touched" in message
    assert calls.made == []


def test_every_driver_is_tried_and_what_failed_is_said(config, driver, monkeypatch):
    calls = Calls(monkeypatch, safe=7)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    report = make_safe(planned(config, {"a": driver, "b": driver}))
    assert report.failed == [
        "driver a: its outputs could not be made safe, code 7",
        "driver b: its outputs could not be made safe, code 7",
    ]
    assert report.safe == []
    assert sorted(calls.made) == ["close", "close", "open", "open", "safe", "safe"]


@pytest.mark.parametrize(
    ("codes", "made", "said"),
    [
        ({"open": 5}, ["open"], ["driver a could not be opened: code 5"]),
        ({"close": 6}, ["open", "safe", "close"], ["driver a could not be closed: code 6"]),
        (
            {"safe": 7, "close": 6},
            ["open", "safe", "close"],
            ["driver a: its outputs could not be made safe, code 7", "driver a could not be closed: code 6"],
        ),
    ],
)
def test_device_that_fails(config, driver, monkeypatch, codes, made, said):
    calls = Calls(monkeypatch, **codes)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    assert make_safe(planned(config, {"a": driver})).failed == said
    assert calls.made == made


def test_failure_ends_with_69(config, driver, monkeypatch, capsys):
    calls = Calls(monkeypatch, open=5)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    assert ended(config) == 69
    said = capsys.readouterr()
    assert said.err == "micromanip: driver cell could not be opened: code 5\n"
    assert "at their safe value" not in said.out
    with DeviceLocks(["bench"]), pytest.raises(CheckFailed):
        make_safe(plan_of(config))


class Hung(Bus):
    """Its device is another one; what it can't do is a bug of its driver."""

    device = "other"

    def open(self):
        raise TypeError("unsupported operand")


def bridge(bus):
    return BusBridge(bus, BusOptions(), 1)


def test_one_driver_keeps_no_other_one_from_rest(config, driver, monkeypatch):
    """A bug in one, a device that refuses one task in another, a good one, a cyclic one that fails."""
    calls = Calls(monkeypatch, safe=7)
    monkeypatch.setattr(type(driver), "functions", lambda self: calls.functions)
    monkeypatch.setattr("micromanip.host.safe.bus_rest.PATIENCE_S", 0.15)
    outputs = OUTPUTS
    good, half = Bus(voltage_x=80.0), Bus(voltage_x=80.0, voltage_y=80.0)
    good.device, half.device = "good", "half"
    half.raises[1] = DeviceFault("unit 3")
    drivers = {"hung": bridge(Hung()), "half": bridge(half), "cyclic": driver, "good": bridge(good)}
    report = make_safe(planned(config, drivers, dict.fromkeys(("hung", "half", "good"), outputs)))
    assert good.has == SAFE
    assert half.has["voltage_y"] == 10.0
    assert report.safe == ["good"]
    assert [line.split(":")[0] for line in report.failed] == [
        "driver hung",
        "driver half",
        "driver half",
        "driver cyclic",
    ]
    assert report.failed[0] == "driver hung: its outputs are unknown, bug: TypeError: unsupported operand"
    x, y = report.failed[1:3]
    assert x.startswith("driver half: voltage_x (safe: 0 V) can't be called safe: unknown, last 80 V; ")
    assert y.startswith("driver half: ")
    assert x != y


def test_what_nobody_knows_is_not_written_to_and_named(config):
    bus = Bus()
    bus.asked = False
    report = make_safe(planned(config, {"bus": bridge(bus)}, {"bus": OUTPUTS}))
    assert report.safe == []
    assert all(line.startswith("driver bus: ") for line in report.failed)
    assert "nobody knows what voltage_x, voltage_y of bench has: nothing is written" in report.failed[0]


def test_what_has_no_outputs_is_not_opened_and_not_called_safe(config):
    sensor = Bus()
    sensor.outputs = ()
    report = make_safe(planned(config, {"sensor": bridge(sensor)}, {"sensor": ()}))
    assert (report.safe, report.failed, sensor.opened) == ([], [], 0)


def test_the_devices_are_locked_meanwhile(config):
    class Looks(Bus):
        def open(self):
            super().open()
            with pytest.raises(CheckFailed, match="is in use"):
                make_safe(plan)

    plan = planned(config, {"bus": bridge(Looks())}, {"bus": OUTPUTS})
    assert make_safe(plan).failed == []


def test_waiting_for_a_loop_that_still_ramps(config):
    first = DeviceLocks(["bench"])
    timer = threading.Timer(0.2, first.release)
    timer.start()
    assert ended(config, "--wait", "60") == 0
    timer.join()
