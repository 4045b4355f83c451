"""The driver against the contract, on the test bus: with a device that dies on its bus, and with a bus that dies."""

import random
import struct

import pytest
from micromanip_drivers.canbus.driver import CanBus

from campaigns.report import CONFIG
from micromanip.bus.can_bits import FD_LENGTHS
from micromanip.conformance.lifetime import LifetimeChecks
from micromanip.conformance.link import LinkChecks
from micromanip.driver.conformance import BusDriverContract, Golden
from micromanip.testbus.frame import Frame

from .compiled_socket import CompiledCanBus
from .device_on_hub import BusPeer, Gate, channel_name, cut, strange, unit
from .hub_in_thread import BITRATE, DATA_BITRATE, bench

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

RATE_HZ = 200
VOLTAGES, SENSORS = 0x100, 0x101
FD = {"fd": True, "bitrate_switch": True}
POSITIONS = [f"Sensors.{quantity}_{axis}" for quantity in ("strain", "stage") for axis in "xyz"]
SWITCHES = ("amplifier_enable", "feed_hold", "heartbeat")
LINES = [
    f"Sensors.{line}"
    for line in (
        *("enable", "interlock", "retracted"),
        *(f"amplifier_ok_{axis}" for axis in "xyz"),
        *(f"temperature_ok_{axis}" for axis in "xyz"),
    )
]
OUTPUTS = [f"Voltages.{name}" for name in (*(f"voltage_{axis}" for axis in "xyz"), *SWITCHES)]


def commands(data):
    return unit(VOLTAGES, data, **FD)


class Manipulator:
    """The device of `can/manipulator.dbc`, its frames laid out by hand."""

    def __init__(self, gate, loop):
        self.gate, self.loop = gate, loop
        self.values = dict.fromkeys((*POSITIONS, *LINES), 0.0)
        self.count = 0
        self.on = True
        gate.attach(self)
        self.report(loop.now_ns())

    def on_frame(self, frame, time_ns):
        """Commands are kept by the gate."""

    def report(self, due_ns):
        if not self.on:
            return
        codes = b"".join(round(self.values[name] / 1e-4).to_bytes(3, "little", signed=True) for name in POSITIONS)
        lines = sum(int(self.values[name]) << bit for bit, name in enumerate(LINES))
        data = codes + b"\0" + lines.to_bytes(3, "little") + self.count.to_bytes(2, "little")
        if not self.gate.silent:
            self.gate.send(self, Frame(SENSORS, data, **FD), due_ns)
            self.count = (self.count + 1) % (1 << 16)
        next_ns = due_ns + round(1e9 / RATE_HZ)
        self.loop.call_at(next_ns, lambda: self.report(next_ns))


class ManipulatorPeer(BusPeer):
    data_bitrate = DATA_BITRATE
    counter_range = 1 << 16

    @property
    def options(self):
        return {
            "interface": "micromanip",
            "channel": self.channel,
            "bitrate": BITRATE,
            "data_bitrate": DATA_BITRATE,
            "database": "can/manipulator.dbc",
            "receive": {"Sensors": {"rate_hz": RATE_HZ, "counter": "Count", "status": {"signal": "Status"}}},
            "send": {"Voltages": {"rate_hz": RATE_HZ, "counter": "Count"}},
        }

    def build(self):
        gate = Gate(self.at.hub)
        self.device = Manipulator(gate, self.at.loop)
        return [gate]

    def leave(self):
        self.device.on = False
        self.gates[0].detach(self.device)

    def set_input(self, channel, value):
        self.at.ask(lambda: self.device.values.update({channel: value}))

    def skip(self, count):
        def leave_out():
            self.device.count = (self.device.count + count) % (1 << 16)

        self.at.ask(leave_out)

    def write(self, frame):
        if frame.identifier != VOLTAGES:
            return None
        *codes, switches = struct.unpack("<HHHBx", frame.data)
        values = [*(code * 0.00275 - 22 for code in codes), *(float(switches >> bit & 1) for bit in range(3))]
        return dict(zip(OUTPUTS, values, strict=True))


class TestCanBus(BusDriverContract):
    """A device that hangs and dies, on a bus that goes on."""

    driver = CanBus
    folder = CONFIG
    checksummed = False
    out_of_range = (150.0015, -20.0024)
    golden_inputs = (
        Golden(
            dict(zip(POSITIONS, (12.5, -0.0001, 150.0, -300.0, 0.1, 0.0), strict=True))
            | dict(zip(LINES, (1, 0, 1, 0, 1, 0, 1, 0, 1), strict=True)),
            (unit(SENSORS, "48e801 ffffff 60e316 4039d2 e80300 000000 00 5501 00 0020", **FD),),
        ),
        Golden(
            dict(zip(POSITIONS, (-838.8608, 838.8607, 20.0, -20.0, 0.0, -0.0001), strict=True))
            | dict(zip(LINES, (0, 1, 0, 1, 0, 1, 0, 1, 0), strict=True)),
            (unit(SENSORS, "000080 ffff7f 400d03 c0f2fc 000000 ffffff 00 aa00 00 0040", **FD),),
        ),
    )
    golden_outputs = (
        Golden(dict(zip(OUTPUTS, (60.5, -19.8, 148.5, 1, 0, 1), strict=True)), (commands("3075 2003 30f2 05 00"),)),
        Golden(dict(zip(OUTPUTS, (0.0, 33.0, 88.0, 0, 1, 0), strict=True)), (commands("401f 204e 409c 02 00"),)),
        Golden(dict(zip(OUTPUTS, (-20.0, 150.0, -20.0, 1, 1, 1), strict=True)), (commands("d702 51f4 d702 07 00"),)),
    )

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def bus(cls):
        with bench(channel_name()) as cls.at:
            yield

    def peer(self):
        return ManipulatorPeer(self.at)

    def garbage(self):
        return strange([SENSORS], (0x000, 0x080, 0x102, 0x7FF), random.Random(4), fd=True)

    def partial(self):
        return cut((wire for golden in self.golden_inputs for wire in golden.wire), FD_LENGTHS)


@pytest.mark.compiled_only
class TestCompiledCanBus(TestCanBus):
    """The same of the compiled functions."""

    driver = CompiledCanBus
    test_killed_in_mid_write = None  # each of its processes loads a compiler: test_steady_worker.py kills one


class TestBusThatDies(LinkChecks, LifetimeChecks):
    """Adapter unplugged, network down."""

    driver = CanBus
    folder = CONFIG

    def peer(self):
        return ManipulatorPeer(None)
