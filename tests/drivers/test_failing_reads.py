"""Devices whose reads fail while they take what is written: their outputs come to rest all the same."""

import contextlib
import time

import pytest
from micromanip_drivers.line.driver import Line
from micromanip_drivers.modbus.driver import Modbus

from micromanip.bus import device_lock
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules
from micromanip.emulation.modbus.frames import RtuFrames, TcpFrames
from micromanip.emulation.modbus.register import DeviceRegister
from micromanip.emulation.modbus.server import answer
from micromanip.emulation.modbus.unit import HOLDING, ModbusUnit
from micromanip.host.safe.bus_rest import BusRest
from micromanip.rt.bus_image import FOLLOWING

from .line.gcs_controller import GcsController
from .line.line_peer import LinePeer
from .line.wires import PtyWire, TcpWire
from .modbus.unit_peer import Behind
from .running_worker import RunningWorker

pytestmark = pytest.mark.live  # ramps and time-outs take their time

HIGH_V, STEP_V, RATE_HZ, RAMP_S = 40.0, 5.0, 100.0, 0.2
SAYS_NAN, SAYS_NOTHING, SAYS_BLANK, SAYS_HALF, REFUSES = "nan", "nothing", "a blank line", "half a line", "an error"


class FailingGcs(GcsController):
    """Its POS? goes wrong from the moment that `fails` is set; all else goes well."""

    fails = None

    def __init__(self):
        super().__init__(TcpWire())
        self.has = self.highest_step = 0.0

    def answer(self, line):
        command, *words = line.split()
        if command == "POS?" and self.fails is not None:
            said = {SAYS_NAN: "1=nan\n", SAYS_NOTHING: "", SAYS_BLANK: "\n", SAYS_HALF: "1=12.", REFUSES: ""}[
                self.fails
            ]
            self.error = 5 if self.fails == REFUSES else self.error
            self.say(said)
        elif command == "SVA?":
            self.say(" \n".join(f"{word}={self.has if word == '1' else 0.0:.4f}" for word in words) + "\n")
        else:
            super().answer(line)
        if command == "SVA":
            self.take_voltage(float(words[1]))

    def take_voltage(self, value):
        self.highest_step = max(self.highest_step, abs(value - self.has))
        self.has = value

    def driver(self, folder):
        return Line(Line.Options.model_validate(self.options), folder)


UNPLUGGED, EXCEPTION = "unplugged", "exceptions"


class TwoUnits(LinePeer):
    """A gauge and an amplifier on one line. The gauge is unplugged, or the amplifier answers no reading any more."""

    fails = None

    def __init__(self, wire, frames):
        super().__init__(wire)
        self.frames, self.has, self.highest_step = frames, 0.0, 0.0
        self.gauge, self.amplifier = ModbusUnit("gauge", Behind(self)), ModbusUnit("amplifier", self)
        self.gauge.add_measured(HOLDING, DeviceRegister("", 0, "int16"), "gauge.strain_x")
        for unit in (self.gauge, self.amplifier):
            unit.add_constant(HOLDING, DeviceRegister("", 9, "uint16"), 1)
        self.amplifier.add_output(HOLDING, DeviceRegister("", 100, "int16", scale=0.005), "amplifier.voltage_x")

    def power_on(self):
        super().power_on()
        self.hearing = None

    def advance_to(self, now_ns):
        pass

    def write(self, values):
        value = values["amplifier.voltage_x"]
        self.highest_step = max(self.highest_step, abs(value - self.has))
        self.has = value

    def take(self, data):
        self.hearing = self.hearing or self.frames()
        for request in self.hearing.taken(data, 0):
            if self.fails == UNPLUGGED and request.unit == 3:
                continue
            said = answer(self.gauge if request.unit == 3 else self.amplifier, request.pdu, 0)
            if self.fails == EXCEPTION and request.pdu[0] == 3:
                said = bytes((0x83, 4))
            self.wire.write(request.seal(said))

    def driver(self, folder):
        common = {"address_base": 0, "byte_order": "big", "word_order": "big"}
        reads = {"position": {"function": 3, "rate_hz": RATE_HZ, "read": {"strain_x": {"address": 0, "type": "int16"}}}}
        voltage = {"address": 100, "type": "int16", "scale": 0.005, "cyclic_safe": True}
        writes = {"voltages": {"function": 16, "rate_hz": RATE_HZ, "write": {"voltage_x": voltage}}}
        units = {
            "gauge": {**common, "unit_id": 3, "tasks": reads},
            "amplifier": {**common, "unit_id": 7, "tasks": writes},
        }
        if self.fails == EXCEPTION:
            units["amplifier"]["tasks"] |= {
                "state": {"function": 3, "rate_hz": 10.0, "read": {"state": {"address": 9, "type": "uint16"}}}
            }
        options = {
            **self.wire.options,
            "timeout_ms": 30.0,
            "response_ms": 2.0,
            "drain_ms": 90.0,
            "units": units,
            "watchdog": {"ms": None, "after_power_on": "last"},
        }
        return Modbus(Modbus.Options.model_validate(options), folder)


def tcp_units():
    return TwoUnits(TcpWire(), TcpFrames)


def rtu_units():
    return TwoUnits(PtyWire(), lambda: RtuFrames(5_000_000))


CASES = [
    *((FailingGcs, fails) for fails in (SAYS_NAN, SAYS_NOTHING, SAYS_BLANK, SAYS_HALF, REFUSES)),
    *((units, fails) for units in (tcp_units, rtu_units) for fails in (UNPLUGGED, EXCEPTION)),
]


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0].__name__}-{case[1]}")
def device(request, monkeypatch, tmp_path):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path)
    kind, fails = request.param
    peer = kind()
    peer.to_fail = fails
    peer.start()
    yield peer
    peer.kill()


def outputs(driver):
    return [SafeOutput(VOLTAGE, 0.0, -20.0, 100.0, STEP_V * RATE_HZ) for _ in driver.outputs]


def charged(device, folder):
    """A worker that follows the loop, whose first output has HIGH_V."""
    driver = device.driver(folder)
    return RunningWorker(driver, Rules(outputs(driver), RAMP_S, 500_000_000, 100_000_000), None)


def rise(device, worker):
    worker.until(lambda: worker.state == FOLLOWING, 0.0)
    worker.until(lambda: device.has == pytest.approx(HIGH_V), HIGH_V)
    device.fails = device.to_fail


@pytest.mark.parametrize("loop_lives", [True, False])
def test_the_worker_brings_them_to_rest(device, tmp_path, loop_lives):
    with charged(device, tmp_path) as worker:
        rise(device, worker)
        begun = time.monotonic()
        worker.until(lambda: device.has == 0.0 or time.monotonic() - begun > 10.0, 0.0 if loop_lives else None)
        assert device.has == 0.0
    assert device.highest_step <= STEP_V + 0.01


def test_without_a_worker_they_come_to_rest(device, tmp_path):
    device.has, device.fails = HIGH_V, device.to_fail
    driver = device.driver(tmp_path)
    names = [channel.name for channel in driver.outputs]
    with contextlib.closing(LastGiven.open(driver.device, names, tmp_path)) as memory:  # of who controlled it before
        memory.write([HIGH_V, *([0.0] * (len(names) - 1))])
    rest = BusRest(driver, outputs(driver), RAMP_S)
    failed = rest.run()
    assert device.has == 0.0, failed
