"""The device of config/udp.yaml and its driver: whatever befalls the wire, no false value is taken."""

import json
import time

import numpy as np
import pytest
from drivers.called import Called
from testbus.loop_in_thread import LoopInThread

from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.driver.wire import DOWN, TAKEN
from micromanip.emulation.devices import Devices
from micromanip.settings.check import validate
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.places import build_driver
from tools.running_controller import until

from .emulated import CONFIG
from .lines import free_port

# a device that stands still is a lost link: not beside loops that take a CPU for themselves
pytestmark = [pytest.mark.compiled_only, pytest.mark.realtime, pytest.mark.xdist_group("loop")]

PERIOD_NS = 1_000_000
"""Slow: this is about what happens, not how fast."""
SILENT_S = 0.05
STEP_V, RESOLVED_V = 0.6, 2e-4


class Cell(Called):
    """Devices that run in a thread, and the driver, called as a loop calls it."""

    def __init__(self, folder):
        text = (CONFIG / "udp.yaml").read_text(encoding="utf-8").replace("port: 4840", f"port: {free_port()}")
        file = folder / "cell.yaml"
        file.write_text(text, encoding="utf-8")
        self.devices = Devices(file)
        self.device = self.devices.emulated["cell"]
        source = Source.read(file)
        driver = build_driver(source, "cell", validate(source).drivers["cell"], PERIOD_NS, 0)[0]
        limits = SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * 1e9 / PERIOD_NS)
        super().__init__(driver, [limits] * len(driver.outputs))
        self.devices.start()
        self._running = LoopInThread(self.devices.loop)
        self.at_ns = 0

    def order(self, **command):
        answer = self._running.ask(lambda: self.devices.command(json.dumps(command)))
        assert "error" not in answer, answer

    def open(self):
        super().open()
        self.at_ns = time.monotonic_ns()
        return self

    def run(self, seconds, voltage=0.0):
        """Exchange with a voltage on all axes; the codes, and the strains of axis x that were fresh."""
        codes, strains = [], []
        end_ns = self.at_ns + round(seconds * 1e9)
        while self.at_ns < end_ns:
            self.at_ns = max(
                self.at_ns + PERIOD_NS, time.monotonic_ns()
            )  # as a loop: what is missed is not made up for
            time.sleep(max(0, self.at_ns - time.monotonic_ns()) * 1e-9)
            self.outputs[:6] = (voltage, voltage, voltage, 1.0, 0.0, 0.0)  # the driver leaves there what it gave
            before = int(self.signals[0]["sequence"])
            codes.append(self.exchange_at(self.at_ns))
            if self.signals[0]["sequence"] != before and self.signals[0]["status"] == 0:
                strains.append(float(self.signals[0]["value"]))
        return codes, strains

    def reach(self, code, voltage=0.0):
        """Exchange until the driver says `code`, on however busy a machine."""
        deadline_s = time.monotonic() + 10.0
        while (said := self.run(PERIOD_NS * 1e-9, voltage)[0][-1]) != code:
            assert time.monotonic() < deadline_s, f"the driver still says {said}, not {code}"
        return self

    def lift(self, voltage):
        for volts in np.linspace(0, voltage, 60):
            self.run(PERIOD_NS * 1e-9, volts)
        return self

    def largest_step_V(self):
        return max(figures["largest_step_V"] for name, figures in self.outputs_report().items() if figures["samples"])

    def outputs_report(self):
        return self.devices.report()["outputs"]

    def close(self):
        self._running.end()
        super().close()
        self.devices.close()


@pytest.fixture
def cell(tmp_path):
    found = Cell(tmp_path)
    yield found
    found.close()


@pytest.mark.parametrize(
    ("kind", "keys", "counter"),
    [
        ("drop", {"share": 0.3}, "lost"),
        ("duplicate", {"share": 0.3}, "doubled"),
        ("reorder", {"share": 0.3}, "late"),
        ("delay", {"share": 0.1, "ms": 3}, "unanswered"),
        ("flip", {"share": 0.3}, "wrong_checksum"),
        ("short", {"share": 0.3}, "wrong_length"),
        ("garbage", {"share": 0.3}, "wrong_length"),
    ],
)
def test_a_bad_wire_is_counted_and_spoils_no_sample(cell, kind, keys, counter):
    cell.open().run(0.05)
    cell.lift(20.0).run(0.3, 20.0)
    _, calm = cell.run(0.1, 20.0)
    before = cell.statistics[counter]
    cell.order(inject=kind, for_s=0.3, **keys)
    _, strains = cell.run(0.3, 20.0)
    assert cell.statistics[counter] > before
    assert strains
    assert np.abs(np.array(strains) - np.mean(calm)).max() < 1.0
    cell.reach(0)
    if cell.statistics["losses"] == 0:
        assert cell.largest_step_V() <= STEP_V + RESOLVED_V
    else:  # on a machine that stands still the link is lost, and the device has gone to rest before it is told to
        assert cell.devices.cell.amplifiers[0].trips >= 1


@pytest.mark.parametrize("command", [{"inject": "unplug"}, {"device": "silence"}, {"inject": "drop", "share": 1.0}])
def test_a_break_too_short_to_be_one_makes_no_step(cell, command):
    """The loop moves on meanwhile: afterwards the device is led to where the loop is."""
    cell.open().run(0.05)
    cell.order(**command, for_s=0.7 * SILENT_S)
    assert cell.lift(30.0).run(0.2, 30.0)[0][-1] == 0
    assert cell.devices.cell.voltages()["voltage_x"] == pytest.approx(30.0, abs=1e-3)
    assert cell.statistics["held_back"] > 0
    assert cell.largest_step_V() <= STEP_V + RESOLVED_V


AWAY = [{"device": "silence"}, {"inject": "hang"}, {"device": "reboot"}, {"inject": "unplug"}]


@pytest.mark.parametrize("command", AWAY)
def test_a_device_that_was_away_comes_back_at_rest(cell, command):
    """Silent, or without power: down; then its safe values, also while the loop wants others; nothing steps."""
    cell.open().run(0.05)
    cell.lift(20.0).run(0.1, 20.0)
    cell.order(**command, for_s=0.2)
    cell.reach(DOWN, 20.0).reach(TAKEN, 20.0).reach(0)
    assert cell.devices.cell.voltages()["voltage_x"] == pytest.approx(0.0, abs=1e-4)
    cell.lift(10.0).reach(0, 10.0)
    assert cell.devices.cell.amplifiers[0].ok
    commanded = [name for name in cell.outputs_report() if name.startswith("voltage")]
    assert commanded


def test_a_controller_that_dies_leaves_the_device_to_its_watchdog(cell):
    cell.open().run(0.05)
    cell.lift(20.0).run(0.05, 20.0)
    cell.order(report=True)
    until(lambda: cell.devices.cell.amplifiers[0].trips, "the watchdog does not trip")
    until(lambda: cell.devices.cell.voltages()["voltage_x"] == 0.0, "the amplifier is not discharged")
    assert cell.devices.cell.amplifiers[0].trips == 1
    assert cell.driver.safe_in_host()(cell.context) == 0
