"""The framings `ascii` (preset gcs), `binary` and `stream` against the contract of bus drivers: TCP, terminal, UDP."""

import pytest
from micromanip_drivers.line.driver import Line

from micromanip.driver.conformance import BusDriverContract, Golden

from .board import FRAMING as BOARD
from .board import Board
from .compiled_line import CompiledLine
from .gcs_controller import FRAMING as GCS
from .gcs_controller import GcsController
from .sensors import SENSOR, CapacitiveSensor, LaserTracker
from .wires import PtyWire, TcpWire, UdpWire

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

ANOTHER_GCS = {"ascii": {**GCS["ascii"], "identity": "Physik Instrumente.*E-709"}}
_ETHERNET_BITS = 8 * (38 + 20 + 32)
_ACKNOWLEDGED_BITS = 8 * 84


class TcpGcs(GcsController):
    """An exchange is two packets, and two that acknowledge them."""

    def busy_s(self):
        with self.lock:
            heard, said, asked = self.heard, self.said, self.asked
            self.heard, self.said, self.asked = 0, 0, []
        exchanges = sum(command in ("POS?", "SVA") for command in asked)
        bits = 8 * (heard + said) + 2 * exchanges * (_ETHERNET_BITS + _ACKNOWLEDGED_BITS)
        return {"link 127.0.0.1": bits / 100e6}


class TestGcsOverTcp(BusDriverContract):
    driver = Line
    kills = 2
    checksummed = False
    out_of_range = (120.001, -20.001, 1e300)
    wrong_identity = ANOTHER_GCS
    golden_inputs = (
        Golden({"strain_x": 12.5, "strain_y": -0.25, "strain_z": 0.001}, (b"1=12.5000 \n2=-0.25 \n3=1e-3\n",)),
        Golden({"strain_x": 0.0, "strain_y": 100.0, "strain_z": -7.0}, (b"1=0 \r\n2=+100. \r\n3=-7.0000\r\n",)),
    )
    golden_outputs = (
        Golden(
            {"voltage_x": 60.0, "voltage_y": -20.0, "voltage_z": 0.0001},
            (b"SVA 1 60.0000 2 -20.0000 3 0.0001\nERR?\n",),
        ),
        Golden(
            {"voltage_x": 120.0, "voltage_y": 0.0, "voltage_z": -1.5}, (b"SVA 1 120.0000 2 0.0000 3 -1.5000\nERR?\n",)
        ),
    )

    def peer(self):
        return TcpGcs(TcpWire())


ANOTHER_BOARD = {
    "binary": {
        **BOARD["binary"],
        "identity": {
            **BOARD["binary"]["identity"],
            "numbers": {"serial_number": {"at": 4, "type": "uint32", "byte_order": "little", "value": 1235}},
        },
    }
}


class TestBinaryOnPty(BusDriverContract):
    driver = Line
    wrong_identity = ANOTHER_BOARD
    stale_writes = 4096 // 12  # what the pseudo terminal itself holds on the way, unseen by any driver
    out_of_range = (150.01, -20.01, 1e300)
    golden_inputs = (
        Golden(
            {"strain_x": 12.5, "strain_y": -0.25, "strain_z": 100.0},
            (bytes.fromhex("aa55 0f10 0070 00 48e80100 3cf6ffff 40420f00") + b"\xbb",),
        ),
    )
    golden_outputs = (
        Golden(
            {"voltage_x": 60.0, "voltage_y": -20.0, "voltage_z": 0.005}, (bytes.fromhex("aa55 0820 e02e 60f0 0100"),)
        ),
        Golden(
            {"voltage_x": 150.0, "voltage_y": 0.0, "voltage_z": -0.005}, (bytes.fromhex("aa55 0820 3075 0000 ffff"),)
        ),
    )

    def peer(self):
        return Board(PtyWire())


@pytest.mark.compiled_only
class TestCompiledBinaryOnPty(TestBinaryOnPty):
    """The same of the compiled functions."""

    driver = CompiledLine
    test_killed_in_mid_write = None  # each of its processes loads a compiler


ANOTHER_SENSOR = {
    "stream": {
        **SENSOR["stream"],
        "identity": {"serial_number": {"at": 8, "type": "int32", "byte_order": "little", "value": 4712}},
    }
}


class TestSensorOverTcp(BusDriverContract):
    driver = Line
    checksummed = False
    wrong_identity = ANOTHER_SENSOR
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
    test_stopped_and_continued = None  # TestCompiledBinaryOnPty has it


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
