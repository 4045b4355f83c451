"""A worker, a real driver and an emulated device of each bus: no cut, no death and no stall is a step on the device.

The device has no watchdog of its own here, so each value that arrives is in force. The loop is one that asks for the
extremes. The same with the whole daemon: tests/hil/test_steps.py.
"""

import json
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from hil.step_cells import BUSES, CUTS, RAMP_S, RANGE_V, step_cell, step_V
from testbus.loop_in_thread import LoopInThread

from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.worker import Rules, Worker
from micromanip.emulation.devices import Devices
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import FOLLOWING, IMAGE, RESTING
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.settings.check import prepare

pytestmark = pytest.mark.live  # ramps and pauses take their time

NEVER_MS, PATIENCE_S, RESOLVED_V = 1e9, 60.0, 0.01
DEAD_NS, PATIENCE_NS = 300_000_000, 300_000_000
HELD_V = 80.0


class Emulated:
    """The device, in a thread of its own."""

    def __init__(self, file):
        self._devices = Devices(file, watchdog_ms=NEVER_MS)
        self._devices.start()
        self._running = LoopInThread(self._devices.loop)

    def order(self, **order):
        answer = self._running.ask(lambda: self._devices.command(json.dumps(order)))
        assert "error" not in answer, answer
        return answer

    def figures(self):
        """Of the voltages that came since the last call."""
        return self.order(report=True)["outputs"]["voltage_x"]

    def end(self):
        self._running.end()
        self._devices.close()


class Cell:
    """Device, worker after worker, and the loop's side of the image."""

    def __init__(self, folder, bus):
        (folder / "cell.yaml").write_text(step_cell(bus))
        self.folder, self.prepared = folder, prepare(folder / "cell.yaml")
        (self.name,) = self.prepared.wiring.buses
        self.bridge = self.prepared.wiring.buses[self.name]
        self.device = Emulated(folder / "cell.yaml")
        self.outputs, self.signals = np.zeros(MAX_OUTPUTS), np.zeros(MAX_SIGNALS, SIGNAL)
        self.place = self.prepared.wiring.outputs["voltage_x"]
        self.worker = None
        self.begin()

    def begin(self, remembers=True, keeps_image=False):
        """Another worker; without memory and image nobody but the device knows what it was given."""
        bus, configuration = self.bridge.bus, self.prepared.configuration
        if not keeps_image:
            self.record = self.bridge.context().view(IMAGE)
            self.record["silent_ns"] = 10**12
            self.image = ProcessImage(self.record)
        memory = None
        if remembers:
            memory = LastGiven.open(bus.device, [output.name for output in bus.outputs], self.folder)
        outputs = self.prepared.wiring.safe_outputs(self.name, configuration)
        self.worker = Worker(bus, self.image, Rules(outputs, RAMP_S, DEAD_NS, PATIENCE_NS), memory, simulated=True)
        self.thread = threading.Thread(target=self._run, args=(self.worker,))
        self.thread.start()

    def _run(self, worker):
        try:
            worker.run()
        except KilledError:
            return

    def kill(self):
        """The worker dies between two tasks, with whatever it has written."""
        worker, deliver = self.worker, self.bridge.bus.perform

        def perform(*args):
            deliver(*args)
            raise KilledError

        self.bridge.bus.perform = perform
        self.until(lambda: not self.thread.is_alive(), HELD_V)
        self.bridge.bus.perform = deliver
        assert worker is self.worker

    def cycle(self, voltage_V):
        self.outputs[self.place] = voltage_V
        return exchange_image(self.record[0], self.outputs, self.signals, time.monotonic_ns())

    def until(self, condition, voltage_V=None):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, "it did not come to pass"
            if voltage_V is not None:
                self.cycle(voltage_V)
            time.sleep(0.001)

    @property
    def given_V(self):
        known = self.image.known(self.place + 1)
        return None if known is None else known[self.place]

    def hold(self):
        """At rest, then in the loop's hand, then at its voltage."""
        self.until(lambda: self.worker.safe.state == FOLLOWING, 0.0)
        self.until(lambda: self.given_V == pytest.approx(HELD_V, abs=RESOLVED_V), HELD_V)

    def end(self):
        self.worker.end()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()
        self.device.end()


class KilledError(Exception):
    """What ends a worker in the middle."""


@contextmanager
def held(folder, bus):
    cell = Cell(folder, bus)
    try:
        cell.hold()
        yield cell
    finally:
        cell.end()


WORST = {"largest_step_V": max, "max": max, "min": min}


def judge(cell, bus, to_rest=True):
    found, end_s = cell.device.figures(), time.monotonic() + 5.0
    while to_rest and found["min"] > RESOLVED_V and time.monotonic() < end_s:  # the last frame is still on its way
        more = cell.device.figures()
        found |= {name: worst(found[name], more[name]) for name, worst in WORST.items()}
    assert found["largest_step_V"] <= step_V(bus) + RESOLVED_V
    assert RANGE_V[0] - RESOLVED_V <= found["min"] <= found["max"] <= RANGE_V[1] + RESOLVED_V
    if to_rest:
        assert found["min"] == pytest.approx(0.0, abs=RESOLVED_V)


@pytest.mark.parametrize("bus", BUSES)
def test_a_link_that_was_cut_for_longer_than_the_ramp(tmp_path, bus):
    with held(tmp_path, bus) as cell:
        judge(cell, bus, to_rest=False)
        cell.device.order(inject=CUTS[bus], for_s=3 * RAMP_S)
        cell.until(lambda: cell.image.output_state == "unknown", HELD_V)
        assert cell.given_V == pytest.approx(HELD_V, abs=step_V(bus))
        cell.until(lambda: cell.image.output_state == "at rest", HELD_V)
        judge(cell, bus)
        cell.hold()
        judge(cell, bus, to_rest=False)


@pytest.mark.parametrize("bus", BUSES)
def test_a_worker_that_was_dead_for_longer_than_the_ramp(tmp_path, bus):
    """Only the worker was killed, and then the host with it."""
    with held(tmp_path, bus) as cell:
        for keeps_image in (True, False):
            cell.hold()
            cell.device.figures()
            cell.kill()
            time.sleep(3 * RAMP_S)
            cell.begin(keeps_image=keeps_image)
            cell.until(lambda: cell.worker.safe.state == RESTING, HELD_V)
            judge(cell, bus)


@pytest.mark.parametrize("bus", ["modbus", "gcs"])
def test_a_device_that_can_be_asked_is_led_on_from_what_it_says(tmp_path, bus):
    """Nothing is remembered: the file is gone, and so is the image."""
    with held(tmp_path, bus) as cell:
        cell.device.figures()
        cell.kill()
        cell.begin(remembers=False)
        cell.until(lambda: cell.worker.safe.state == RESTING, HELD_V)
        judge(cell, bus)


@pytest.mark.parametrize("bus", BUSES)
def test_a_loop_that_stood_still_and_goes_on_where_it_likes(tmp_path, bus):
    """Before it is taken for dead, and after."""
    with held(tmp_path, bus) as cell:
        for stop_s in (0.05, 0.5):
            cell.device.figures()
            time.sleep(stop_s)
            for wanted_V in (RANGE_V[1], RANGE_V[0], HELD_V):
                end = time.monotonic() + 0.2
                cell.until(lambda until=end: time.monotonic() > until, wanted_V)
            judge(cell, bus, to_rest=False)
            cell.hold()
