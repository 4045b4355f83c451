"""Against the `canopen` library: its master reads and drives our node, its node answers our driver."""

import contextlib

import canopen
import pytest

from micromanip.bus.inbox import Inbox
from micromanip.emulation.can.canopen_node import OPERATIONAL
from micromanip.testbus.client import HubBus

from .cell import AMPLIFIER, EDS, SENSOR, cell, wait_for

pytestmark = pytest.mark.live  # the library's thread beside ours, and the node's watchdog


@pytest.fixture
def at():
    with cell() as at:
        yield at


@contextlib.contextmanager
def network(at):
    """The library's own view of the bus, with its receiving thread."""
    network = canopen.Network(HubBus(at.channel))
    network.NOTIFIER_CYCLE = 0.05
    network.connect()
    try:
        yield network
    finally:
        network.disconnect()


def test_library_reads_our_sensor(at):
    with network(at) as master:
        node = master.add_node(SENSOR, str(EDS / "sensor.eds"))
        assert node.sdo["Identity object"]["Product code"].raw == 0x404
        assert node.sdo[0x1A02][2].raw == 0x81300618
        with pytest.raises(canopen.SdoAbortedError, match="read only"):
            node.sdo[0x1018][1].raw = 7
        with pytest.raises(canopen.SdoAbortedError, match="present device state"):
            node.sdo[0x1A00][0].raw = 0  # the PDO is on
        with pytest.raises(canopen.SdoAbortedError, match="Object does not exist"):
            node.sdo.upload(0x5555, 0)
        node.sdo[0x1017].raw = 10
        node.tpdo.read()
        at.values |= {"strain_y": -3.25, "stage_y": 200.5}
        node.nmt.state = "OPERATIONAL"
        wait_for(lambda: at.nodes["sensor"].state == OPERATIONAL)
        master.sync.transmit()
        wait_for(lambda: node.tpdo[2].timestamp is not None)
        assert node.tpdo[2]["AI input PV.strain_y"].raw == -32500
        assert node.tpdo[2]["AI input PV.stage_y"].phys == pytest.approx(200.5)


def test_library_maps_and_drives_our_amplifier(at):
    with network(at) as master:
        node = master.add_node(AMPLIFIER, str(EDS / "amplifier.eds"))
        node.rpdo.read()
        node.rpdo[1].clear()
        node.rpdo[1].add_variable("Write analogue output 16 bit", "voltage_z")
        node.rpdo[1].event_timer = 20
        node.rpdo[1].save()
        emergencies = []
        node.emcy.add_callback(emergencies.append)
        node.nmt.state = "OPERATIONAL"
        node.rpdo[1]["Write analogue output 16 bit.voltage_z"].phys = -12.5
        node.rpdo[1].transmit()
        wait_for(lambda: at.values.get("voltage_z") == -12.5)
        wait_for(lambda: emergencies)
        assert emergencies[0].code == 0x8250
        assert at.values["voltage_z"] == 0.0


def test_our_frames_are_the_librarys():
    """The library's node unpacks what the driver packs, at the ends of the range too."""
    with cell(amplifier=False) as at, network(at) as bus_of_library:
        node = bus_of_library.create_node(AMPLIFIER, str(EDS / "amplifier.eds"))
        node.nmt.state = "INITIALISING"
        node.nmt.state = "PRE-OPERATIONAL"
        node.rpdo.read()
        bus = at.driver()
        bus.open()
        rpdo = next(i for i, task in enumerate(bus.tasks) if task.outputs)
        for volts in ((-20.0, 0.005, 150.0), (0.0, -0.005, 33.333)):
            before = node.rpdo[1].timestamp
            bus.perform(rpdo, volts, Inbox())
            wait_for(lambda before=before: node.rpdo[1].timestamp != before)
            received = [variable.phys for variable in node.rpdo[1]]
            assert received == pytest.approx(volts, abs=0.0026)
        bus.close()
