"""Sensor, amplifier and tracker on a test bus that runs beside the test, and a worker's round for the driver."""

import contextlib
import copy
import itertools
import os
import time

from micromanip_drivers.canopen.driver import CanOpen

from campaigns.report import CONFIG
from micromanip.bus.errors import TransientError
from micromanip.bus.inbox import Inbox
from micromanip.emulation.can.canopen_node import CanOpenNode

from ..canbus.hub_in_thread import bench
from ..changed_options import put

EDS = CONFIG / "can"
AXES = "xyz"
SENSOR, AMPLIFIER = 5, 6
BITRATE = 1_000_000
_numbers = itertools.count()

OPTIONS = {
    "interface": "micromanip",
    "channel": "",
    "bitrate": BITRATE,
    "sync_hz": 200.0,
    "nodes": {
        "sensor": {
            "node_id": SENSOR,
            "eds": "can/sensor.eds",
            "heartbeat_ms": 240,
            "identity": {"vendor_id": 0xFFFF0001, "product_code": 0x404},
            "tpdo": {
                i + 1: {"rate_hz": 200.0, "signals": {f"{q}_{axis}": {"scale": 1e-4} for q in ("strain", "stage")}}
                for i, axis in enumerate(AXES)
            },
        },
        "amplifier": {
            "node_id": AMPLIFIER,
            "eds": "can/amplifier.eds",
            "heartbeat_ms": 240,
            "watchdog_ms": 200,
            "rpdo": {1: {"rate_hz": 200.0, "signals": {f"voltage_{axis}": {"scale": 0.005} for axis in AXES}}},
        },
    },
}


def options(**changes):
    """The options above, changed: ``nodes__sensor__node_id=7`` goes down into them, DELETE removes a key."""
    changed = copy.deepcopy(OPTIONS)
    for path, value in changes.items():
        put(changed, [int(key) if key.isdigit() else key for key in path.split("__")], value)
    return changed


def driver(folder=CONFIG, **changes):
    return CanOpen(CanOpen.Options.model_validate(options(**changes)), folder)


class Cell:
    """The devices; what they measure and put out is `values`, by name."""

    def __init__(self, at):
        self.at, self.do = at, at.ask
        self.channel = at.channel
        self.values = {f"{q}_{axis}": 10.0 * (i + 1) for q in ("strain", "stage") for i, axis in enumerate(AXES)}
        self.nodes = {}

    def add(self, name, node_id, eds):
        def build():
            self.nodes[name] = CanOpenNode(self.at.hub, self.at.loop, eds, node_id, self.measure, self.values.update)

        self.do(build)
        return self.nodes[name]

    def measure(self, names):
        return [self.values[name] for name in names]

    def driver(self, folder=CONFIG, **changes):
        return driver(folder, channel=self.channel, **changes)


@contextlib.contextmanager
def cell(sensor=True, amplifier=True):
    with bench(f"canopen-{os.getpid()}-{next(_numbers)}", None) as at:
        cell = Cell(at)
        if sensor:
            cell.add("sensor", SENSOR, EDS / "sensor.eds")
        if amplifier:
            cell.add("amplifier", AMPLIFIER, EDS / "amplifier.eds")
        yield cell


def wait_for(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.001)


def run(bus, values, until, seconds=5.0):
    """What a worker does: the tasks at their rates, reception in between, until `until(samples)` is true."""
    inbox, samples = Inbox(), []
    due = [time.monotonic_ns()] * len(bus.tasks)
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    while not until(samples):
        assert time.monotonic_ns() < end_ns, "it never came"
        for i, task in enumerate(bus.tasks):
            if time.monotonic_ns() >= due[i]:
                due[i] = max(due[i], time.monotonic_ns() - 1_000_000) + round(1e9 / task.rate_hz)
                with contextlib.suppress(TransientError):  # a bus that is slow today: counted, and tried again
                    bus.perform(i, values, inbox)
        bus.receive(inbox, min(due))
        samples += inbox
        inbox.clear()
    return samples
