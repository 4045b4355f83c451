"""Devices whose reads fail while they take what is written: their outputs come to rest all the same."""

import contextlib
import time

import pytest
from bus.running_worker import RunningWorker

from campaigns.cells import CELLS
from campaigns.oracle import Arrivals, Oracle
from campaigns.played.amplifier import OUTPUTS, Amplifier, Habits
from micromanip.bus import device_lock
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules
from micromanip.host.safe.bus_rest import BusRest
from micromanip.rt.bus_image import FOLLOWING
from micromanip.settings.check import prepare

pytestmark = pytest.mark.live  # ramps and time-outs take their time

HIGH_V, RAMP_S = 40.0, 0.2


class Device:
    """A played device behind its port, its driver, and the oracle at its outputs."""

    def __init__(self, bus, fails, folder):
        cell, self.fails = CELLS[bus], fails
        self.amplifier = Amplifier(Habits(reads_back=False), Arrivals())
        self.port = cell.port(self.amplifier, folder)
        (folder / "cell.yaml").write_text(cell.text(self.port.place))
        self.driver = prepare(folder / "cell.yaml").wiring.drivers["piezo"].bus
        self.oracle = Oracle(self.amplifier._arrivals, cell.bounds((folder / "cell.yaml").read_text(), {}))
        step_V = self.oracle.bounds["voltage_x"].step_V
        self.outputs = [
            SafeOutput(VOLTAGE, 0.0, -20.0, 100.0, step_V * channel.rate_hz) for channel in self.driver.outputs
        ]

    def broken(self):
        """Rules of the oracle that were."""
        return {violation.rule for violation in self.oracle.judge(0, time.monotonic_ns())}


CASES = [("gcs", fails) for fails in ("nan", "empty", "silent", "exception", "garbage")]
CASES += [(bus, fails) for bus in ("modbus", "rtu") for fails in ("silent", "exception")]


@pytest.fixture(params=CASES, ids=" ".join)
def device(request, monkeypatch, tmp_path):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path)
    device = Device(*request.param, tmp_path)
    yield device
    device.port.close()


@pytest.mark.parametrize("loop_lives", [True, False])
def test_the_worker_brings_them_to_rest(device, loop_lives):
    rules = Rules(device.outputs, RAMP_S, 500_000_000, 100_000_000)
    with RunningWorker(device.driver, rules, simulated=True) as worker:
        worker.until(lambda: worker.state == FOLLOWING, 0.0)
        device.oracle.armed(time.monotonic_ns())
        worker.until(lambda: device.amplifier.volts()["voltage_x"] == pytest.approx(HIGH_V, abs=0.01), HIGH_V)
        device.amplifier.fails = device.fails
        begun = time.monotonic()
        worker.until(lambda: device.oracle.at_rest() or time.monotonic() - begun > 10.0, 0.0 if loop_lives else None)
        assert device.oracle.at_rest()
    assert not device.broken()


def test_without_a_worker_they_come_to_rest(device, tmp_path):
    device.amplifier.command(dict.fromkeys(OUTPUTS, HIGH_V))
    device.amplifier.fails = device.fails
    names = [channel.name for channel in device.driver.outputs]
    with contextlib.closing(LastGiven.open(device.driver.device, names, tmp_path)) as memory:  # of who had it before
        memory.write([HIGH_V] * 2)
    failed = BusRest(device.driver, device.outputs, RAMP_S).rest()
    assert device.oracle.at_rest(), failed
