"""The driver `line` on the played devices: what it makes of the faults of each line.

Whatever happens to the line, a value that the driver takes was one that the plant had, what it writes arrives or is
told not to have, errors are those of a bus, and it works again afterwards.
"""

import json
import time

import pytest
from micromanip_drivers.line.driver import Line
from micromanip_drivers.line.options import LineOptions
from testbus.loop_in_thread import LoopInThread

from campaigns.fault_cells import free_port
from campaigns.running_controller import until
from micromanip.bus.errors import BusError, IdentityMismatch
from micromanip.bus.inbox import Inbox
from micromanip.emulation.devices import Devices
from micromanip.settings.text.source import Source

from .lines import BOARD, CAPACITIVE, ELSEWHERE, GCS, OUTPUTS, TRACKER, write_cell

pytestmark = pytest.mark.realtime  # a device that stands still is a lost link

SENT = {"voltage_x": 30.0, "voltage_y": 10.0}
"""Both axes stay where they are, far from each other: a value of the wrong one is seen."""
FAULTS = {
    "drop": {"share": 0.5},
    "delay": {"ms": 80.0, "share": 0.3},
    "duplicate": {"share": 0.5},
    "reorder": {"share": 0.5},
    "split": {"share": 0.5},
    "join": {},
    "garbage": {"share": 0.5},
    "flip": {"share": 0.5},
    "short": {"share": 0.5},
    "hang": {},
    "unplug": {},
}
FOR_S = 0.15


class Played:
    """Devices that run in a thread, and the driver that talks to them."""

    def __init__(self, file):
        self.devices = Devices(file, watchdog_ms=1e9)
        self.devices.start()
        self._running = LoopInThread(self.devices.loop)
        options = dict(Source.read(file).data["drivers"]["device"])
        self.driver = Line(LineOptions.model_validate_json(json.dumps(options)), file.parent)
        self.names = [channel.name for channel in self.driver.inputs]
        self.values, self.errors = {name: [] for name in self.names}, []

    def order(self, **command):
        answer = self._running.ask(lambda: self.devices.command(json.dumps(command)))
        assert "error" not in answer, answer

    def talk(self, seconds):
        """What a worker does: each task at its rate, and listening between; lost links are opened again."""
        end_s = time.monotonic() + seconds
        inbox, values = Inbox(), [SENT.get(channel.name, 0.0) for channel in self.driver.outputs]
        due_s = [time.monotonic()] * len(self.driver.tasks)
        opened = True
        while time.monotonic() < end_s:
            try:
                if not opened:
                    self.driver.open()
                    opened = True
                for number, task in enumerate(self.driver.tasks):
                    if time.monotonic() >= due_s[number]:
                        due_s[number] = time.monotonic() + 1.0 / min(task.rate_hz, 200.0)
                        self.driver.perform(number, values, inbox)
                self.driver.receive(inbox, time.monotonic_ns() + 2_000_000)
            except BusError as problem:
                self.errors.append(problem)
                if not opened or type(problem).__name__ != "TransientError":
                    self.driver.close()
                    opened = False
                    time.sleep(0.02)
            for sample in inbox:
                if sample.status == 0:
                    self.values[self.names[sample.channel]].append(sample.value)
            inbox.clear()
        return opened

    def taken(self):
        """Values since the last call, by name."""
        taken, self.values = self.values, {name: [] for name in self.names}
        return taken

    def close(self):
        self.driver.close()
        self._running.end()
        self.devices.close()


STRONG_CRC = {"plus: 5": "plus: 6", "crc8.smbus": "crc16.ibm_3740, byte_order: big"}
"""Eight bits let one of 256 torn frames pass."""


def with_strong_crc(text):
    for old, new in STRONG_CRC.items():
        assert old in text
        text = text.replace(old, new)
    return text


KINDS = {
    "board": (with_strong_crc(BOARD), OUTPUTS),
    "gcs": (GCS, OUTPUTS),
    "capacitive": (CAPACITIVE, ELSEWHERE),
    "tracker": (TRACKER, ELSEWHERE),
}
UNPROTECTED = {("gcs", "flip"), ("capacitive", "flip")}
"""No checksum: a wrong digit is a wrong value, and the gate of the loop has to judge it."""


@pytest.fixture(params=KINDS)
def played(request, tmp_path):
    text, outputs = KINDS[request.param]
    ports = {"device": tmp_path / "tty", "port": free_port(), "listen": free_port(), "more": ""}
    if request.param == "gcs":
        ports["port"] = f"tcp: {{host: 127.0.0.1, port: {free_port()}}}"
    played = Played(write_cell(tmp_path, text.format(**ports), outputs=outputs))
    played.kind = request.param
    try:
        played.driver.open()
        assert played.talk(0.5)
        played.errors.clear()
        yield played
    finally:
        played.close()


def steady(played):
    """Lowest and highest value of each input, with what noise and creep may add."""
    return {name: (min(values) - 1.0, max(values) + 1.0) for name, values in played.taken().items() if values}


def test_no_fault_of_the_line_makes_a_wrong_value(played):
    until(lambda: played.talk(0.2), "the link")
    bounds = steady(played)
    assert {"strain_x", "strain_y"} <= bounds.keys()
    for kind, about in FAULTS.items():
        played.order(inject=kind, for_s=FOR_S, **about)
        played.talk(FOR_S + 0.1)
        disturbed = played.taken()
        for name, (low, high) in bounds.items():
            wrong = [value for value in disturbed[name] if not low <= value <= high]
            assert wrong == [] or (played.kind, kind) in UNPROTECTED, f"{kind}: {name} in {low} to {high}"
        played.taken()
        deadline_s = time.monotonic() + 10.0
        while not (played.talk(0.1) and all(played.values.values())):
            assert time.monotonic() < deadline_s, f"{kind}: no fresh values any more; {played.errors[-1:]}"
        played.taken()
        bounds = {name: (low - 0.2, high + 0.2) for name, (low, high) in bounds.items()}  # the stack creeps
    arrived = played.devices.report()["outputs"]
    for name, volts in SENT.items():
        if arrived.get(name, {"samples": 0})["samples"] and (played.kind, "flip") not in UNPROTECTED:
            assert arrived[name]["max"] == pytest.approx(volts, abs=0.01)
            assert arrived[name]["min"] == pytest.approx(volts, abs=0.01)


def test_another_device_is_refused(played):
    if played.kind == "tracker":
        pytest.skip("it says nothing of who it is")
    played.order(inject="identity")
    played.driver.close()
    with pytest.raises(IdentityMismatch):
        played.driver.open()
