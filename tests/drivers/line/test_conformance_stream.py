"""The framing `stream`, over TCP and UDP, against the contract of bus drivers."""

import pytest
from micromanip_drivers.line.driver import Line

from micromanip.driver.conformance import BusDriverContract, Golden

from .compiled_line import CompiledLine
from .sensors import SENSOR, CapacitiveSensor, LaserTracker
from .wires import TcpWire, UdpWire

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

ANOTHER = {
    "stream": {
        **SENSOR["stream"],
        "identity": {"serial_number": {"at": 8, "type": "int32", "byte_order": "little", "value": 4712}},
    }
}


class TestSensorOverTcp(BusDriverContract):
    driver = Line
    checksummed = False
    wrong_identity = ANOTHER
    golden_inputs = (
        Golden(
            {"strain_x": 12.5, "strain_y": -0.25, "strain_z": 167.77215},
            (
                bytes.fromhex(
                    "4d454153 01000000 67120000 1500000000000000 00000000 0200 0c00 00001000"
                    "000000000000000000000000 d0121300 589effff ffffff00"
                ),
            ),
        ),
    )

    def peer(self):
        return CapacitiveSensor(TcpWire())


@pytest.mark.compiled_only
class TestCompiledSensorOverTcp(TestSensorOverTcp):
    """The same of the compiled functions."""

    driver = CompiledLine
    test_killed_in_mid_write = None  # each of its processes loads a compiler
    test_opened_100_times_leaves_nothing_behind = None  # as in Python, which opens
    test_stopped_and_continued = None  # test_conformance_binary.py has it


class TestTrackerOverUdp(BusDriverContract):
    driver = Line
    golden_inputs = (
        Golden(
            {"stage_x": 1500.0, "stage_y": -0.25, "stage_z": 0.0},
            (
                bytes.fromhex(
                    "4c540001 00100000 0000000000000000 3ff8000000000000 bf30624dd2f1a9fc 0000000000000000 3f742adf"
                ),
            ),
        ),
    )

    def peer(self):
        return LaserTracker(UdpWire())
