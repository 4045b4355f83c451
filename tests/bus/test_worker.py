"""The worker of a bus around a driver that does as it is told: what it gives the device, and how it comes back."""

import itertools
import threading
import time

import numpy as np
import pytest

from micromanip.io.bus import BusDriver, BusOptions, Channel, Load, Task
from micromanip.io.bus_errors import DeviceFault, IdentityMismatch, LinkError, OutputRefused, TransientError
from micromanip.io.image import ProcessImage
from micromanip.io.safe_state import SWITCH, VOLTAGE, SafeOutput, SafeState
from micromanip.io.worker import Worker
from micromanip.rt.image import FOLLOWING, IMAGE, RESTING, exchange_image
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

MS = 1_000_000
RAMP_NS, DEAD_NS = 100 * MS, 300 * MS  # a loaded machine may hold a thread up for tens of ms
PATIENCE_S = 20.0


class ScriptedDriver(BusDriver):
    """Notes what it is given; raises what a test puts into `errors`, one a call."""

    Options = BusOptions
    device, watchdog = "scripted", None
    inputs = (Channel("strain", 1000.0),)
    outputs = (Channel("voltage", 500.0), Channel("feed_hold", 500.0))
    tasks = (Task("write", 500.0, (0, 1)),)

    def __init__(self):
        self.errors, self.open_errors, self.given, self.opened, self.closed = [], [], [], 0, 0
        self.sequence = 0

    def loads(self):
        return (Load("scripted", 0.1, "nothing"),)

    def open(self):
        self.opened += 1
        if self.open_errors:
            raise self.open_errors.pop(0)

    def perform(self, task, values, inbox):
        if self.errors:
            raise self.errors.pop(0)
        self.given.append(tuple(values))

    def receive(self, inbox, until_ns):
        super().receive(inbox, until_ns)
        self.sequence += 1
        inbox.put(0, float(self.sequence), time.monotonic_ns())

    def close(self):
        self.closed += 1


class Bench:
    """A worker in a thread, and the loop's side of its image."""

    def __init__(self, driver=None):
        self.driver = driver or ScriptedDriver()
        self.record = np.zeros(1, IMAGE)
        self.record["inputs"], self.record["outputs"], self.record["silent_ns"] = 1, 2, 10**12
        self.signals, self.outputs = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS)
        self.image = ProcessImage(self.record)
        outputs = [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0), SafeOutput(SWITCH, 1.0, 0.0, 1.0)]
        self.safe = SafeState(outputs, RAMP_NS, DEAD_NS)
        self.worker = Worker(self.driver, self.image, self.safe, 2)
        self.bug = None
        self.thread = threading.Thread(target=self._run)

    def _run(self):
        try:
            self.worker.run()
        except Exception as problem:
            self.bug = problem

    def cycle(self, voltage=0.0):
        self.outputs[0] = voltage
        return exchange_image(self.record[0], self.outputs, self.signals, time.monotonic_ns())

    def until(self, condition, voltage=None):
        """Turn the loop (or, without a voltage, only wait) until `condition` holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, "it did not come to pass"
            if voltage is not None:
                self.cycle(voltage)
            time.sleep(0.0005)

    def follow(self, voltage):
        self.until(lambda: self.safe.state == FOLLOWING, 0.0)
        self.until(lambda: self.driver.given and self.driver.given[-1] == (voltage, 0.0), voltage)


@pytest.fixture
def bench(monkeypatch):
    said = []
    monkeypatch.setattr("micromanip.io.worker.say", said.append)
    bench = Bench()
    bench.said = said
    bench.thread.start()
    yield bench
    bench.worker.end()
    bench.thread.join(PATIENCE_S)
    assert not bench.thread.is_alive()
    assert bench.driver.closed == bench.driver.opened


def events(bench):
    return [document["event"] for document in bench.said if document["event"] != "statistics"]


def test_what_the_loop_decides_arrives_and_what_is_measured_comes_back(bench):
    bench.follow(40.0)
    bench.until(lambda: bench.signals[0]["sequence"] > 3, 40.0)
    assert bench.signals[0]["value"] == bench.signals[0]["sequence"]
    assert bench.cycle(40.0) == 0
    assert bench.image.link == "up"


def test_a_loop_that_dies_leaves_outputs_that_come_to_rest(bench):
    bench.follow(80.0)
    seen = len(bench.driver.given)
    bench.until(lambda: bench.safe.state == RESTING)  # nobody turns the loop any more
    bench.until(lambda: bench.driver.given[-1] == (0.0, 1.0))
    voltages = [given[0] for given in bench.driver.given[seen:]]
    assert all(later <= earlier for earlier, later in itertools.pairwise(voltages))
    assert any(0.0 < voltage < 80.0 for voltage in voltages)  # a ramp, not a step


@pytest.mark.parametrize("problem", [LinkError("unplugged"), DeviceFault("over-current")])
def test_after_a_lost_link_the_outputs_rest_until_the_loop_asks_for_it(bench, problem):
    bench.follow(80.0)
    bench.driver.errors.append(problem)
    bench.until(lambda: bench.driver.opened == 2, 80.0)
    bench.until(lambda: bench.image.link == "up", 80.0)
    bench.until(lambda: bench.safe.state == RESTING, 80.0)
    seen = len(bench.driver.given)
    bench.until(lambda: len(bench.driver.given) > seen + 20, 80.0)
    assert {given[0] for given in bench.driver.given[seen:]} == {0.0}
    assert events(bench) == ["up", "lost", "up"]
    bench.follow(80.0)


def test_errors_now_and_then_are_counted_many_are_a_lost_link(bench):
    bench.follow(10.0)
    bench.driver.errors += [TransientError("late"), OutputRefused("no")]
    bench.until(lambda: not bench.driver.errors, 10.0)
    assert bench.driver.opened == 1
    bench.driver.errors += [TransientError(f"late {k}") for k in range(20)]
    bench.until(lambda: bench.driver.opened == 2, 10.0)
    lost = next(document for document in bench.said if document["event"] == "lost")
    assert lost["text"].startswith("10 errors in the last 40 calls; the last: late")


def test_a_device_that_is_not_the_right_one_is_not_tried_again(bench):
    bench.follow(10.0)
    bench.driver.open_errors = [IdentityMismatch("it says E-727, not E-709")]
    bench.driver.errors.append(LinkError("unplugged"))
    bench.until(lambda: bench.image.link == "latched", 10.0)
    opened = bench.driver.opened
    bench.until(lambda: bench.safe.state == RESTING, 10.0)
    assert bench.driver.opened == opened
    assert events(bench) == ["up", "lost", "latched"]


def test_a_link_that_does_not_come_is_tried_with_growing_pauses(bench):
    bench.driver.open_errors = [LinkError("no such device")] * 3
    bench.driver.errors.append(LinkError("unplugged"))
    bench.until(lambda: bench.driver.opened >= 5, 0.0)
    bench.until(lambda: bench.image.link == "up", 0.0)
    pauses = [document["retry_s"] for document in bench.said if document["event"] == "lost"]
    assert pauses[:4] == sorted(pauses[:4])
    assert pauses[3] > 4 * pauses[0]


def test_a_bug_of_the_driver_ends_the_worker(bench):
    bench.follow(10.0)
    bench.driver.errors.append(ZeroDivisionError("oops"))
    bench.until(lambda: bench.bug is not None, 10.0)
    assert isinstance(bench.bug, ZeroDivisionError)


def test_it_ends_only_when_the_outputs_are_at_rest(bench):
    bench.follow(80.0)
    bench.worker.end()
    time.sleep(0.01)
    assert bench.thread.is_alive()  # the loop still turns
    bench.thread.join(PATIENCE_S)
    assert not bench.thread.is_alive()
    assert bench.driver.given[-1] == (0.0, 1.0)


def test_what_was_sent_is_there_for_the_next_worker():
    bench = Bench()
    bench.image.remember_sent(np.array([80.0, 0.0] + [0.0] * (MAX_OUTPUTS - 2)), 5)
    last, last_ns = bench.image.sent()
    assert (last[0], last_ns) == (80.0, 5)
