"""The driver against the contract, on the test bus: with nodes that hang and die, and with a bus that dies."""

import random
import struct
from types import MappingProxyType

import pytest
from micromanip_drivers.canopen.driver import CanOpen

from micromanip.conformance.link import LinkChecks
from micromanip.driver.conformance import BusDriverContract, Golden
from micromanip.emulation.can.canopen_node import CanOpenNode

from ..canbus.device_on_hub import BusPeer, Gate, channel_name, cut, strange, unit
from ..canbus.hub_in_thread import bench
from ..changed_options import DELETE
from ..compiled_turns import CompiledTurns
from .cell import AMPLIFIER, AXES, CONFIG, EDS, SENSOR, options

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

SYNC, TPDO, RPDO = 0x080, (0x185, 0x285, 0x385), 0x206
INPUTS = [f"sensor.{quantity}_{axis}" for axis in AXES for quantity in ("strain", "stage")]
OUTPUTS = [f"amplifier.voltage_{axis}" for axis in AXES]


class DeafToSync(Gate):
    """Can leave out the answers to SYNCs that are to come."""

    left_out = 0

    def on_frame(self, frame, time_ns):
        if frame.identifier == SYNC and self.left_out:
            self.left_out -= 1
            return
        super().on_frame(frame, time_ns)


class NodesPeer(BusPeer):
    """Sensor and amplifier, by the EDS files of the examples."""

    @property
    def options(self):
        return options(channel=self.channel, nodes__sensor__heartbeat_ms=180, nodes__amplifier__watchdog_ms=DELETE)

    def build(self):
        self.values = dict.fromkeys((*INPUTS, *OUTPUTS), 0.0)
        gates = [DeafToSync(self.at.hub), Gate(self.at.hub)]
        self.nodes = [
            self.node(gate, name, node_id)
            for gate, name, node_id in zip(gates, ("sensor", "amplifier"), (SENSOR, AMPLIFIER), strict=True)
        ]
        return gates

    def node(self, gate, name, node_id):
        def measure(signals):
            return [self.values[f"{name}.{signal}"] for signal in signals]

        return CanOpenNode(gate, self.at.loop, EDS / f"{name}.eds", node_id, measure, lambda _: None)

    def leave(self):
        for node in self.nodes:
            node.detach()

    def set_input(self, channel, value):
        self.at.ask(lambda: self.values.update({channel: value}))

    def skip(self, count):
        self.at.ask(lambda: setattr(self.gates[0], "left_out", count))

    def write(self, frame):
        if frame.identifier != RPDO:
            return None
        return dict(zip(OUTPUTS, (code * 0.005 for code in struct.unpack("<hhh", frame.data)), strict=True))


class TestCanOpen(BusDriverContract):
    """Nodes that hang and die, on a bus that goes on."""

    driver = CanOpen
    folder = CONFIG
    checksummed = False
    out_of_range = (150.0026, -20.0026)
    wrong_identity = MappingProxyType(
        {"nodes": options(nodes__sensor__identity={"vendor_id": 0xFFFF0001, "serial": 7})["nodes"]}
    )
    golden_inputs = (
        Golden(
            dict(zip(INPUTS, (12.5, -0.0001, 150.0, -300.0, 0.1, 0.0), strict=True)),
            tuple(map(unit, TPDO, ("48e801 ffffff", "60e316 4039d2", "e80300 000000"))),
        ),
        Golden(
            dict(zip(INPUTS, (-838.8608, 838.8607, 20.0, -20.0, 0.0, -0.0001), strict=True)),
            tuple(map(unit, TPDO, ("000080 ffff7f", "400d03 c0f2fc", "000000 ffffff"))),
        ),
    )
    golden_outputs = (
        Golden(dict(zip(OUTPUTS, (60.0, -20.0, 150.0), strict=True)), (unit(RPDO, "e02e 60f0 3075"),)),
        Golden(dict(zip(OUTPUTS, (-0.005, 0.005, 12.345), strict=True)), (unit(RPDO, "ffff 0100 a509"),)),
    )

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def bus(cls):
        with bench(channel_name(), None) as cls.at:
            yield

    def peer(self):
        return NodesPeer(self.at)

    def garbage(self):
        unknown = (0x001, 0x100, 0x180, 0x186, 0x485, 0x585, 0x605, 0x7FF)
        return strange((*TPDO, 0x085, 0x705), unknown, random.Random(4))

    def partial(self):
        return cut((wire for golden in self.golden_inputs for wire in golden.wire), range(6))


class CompiledCanOpen(CompiledTurns, CanOpen):
    """The driver by its compiled functions, as far as they go."""


@pytest.mark.compiled_only
class TestCompiledCanOpen(TestCanOpen):
    """The same of the compiled functions."""

    driver = CompiledCanOpen
    test_killed_in_mid_write = None  # each of its processes loads a compiler
    test_opened_100_times_leaves_nothing_behind = None  # as in Python, which opens


class TestBusThatDies(LinkChecks):
    """Adapter unplugged, network down."""

    driver = CanOpen
    folder = CONFIG

    def peer(self):
        return NodesPeer(None)
