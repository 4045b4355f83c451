"""The driver modbus against its contract, over TCP and over a pseudo terminal."""

import random
from types import MappingProxyType

import pytest
from micromanip_drivers.modbus.driver import Modbus

from micromanip.driver.conformance import BusDriverContract, Golden

from ..line.wires import PtyWire, TcpWire
from .unit_peer import Raw, RtuPeer, UnitPeer, units

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

ANOTHER = {"serial_number": {"function": 3, "address": 9, "type": "uint16", "value": 0x1235}}


class TestModbusTcp(BusDriverContract):
    """The transaction number is the driver's, so vectors begin with the number of the unit."""

    driver = Modbus
    checksummed = False
    wrong_identity = MappingProxyType({"units": units(identity=ANOTHER)})
    out_of_range = (163.8376, -163.8426, 1e300)
    golden_inputs = (
        Golden({"cell.strain_x": 12.345, "cell.strain_y": -0.5}, (bytes.fromhex("07 17 08 0000 3039 bf00 0000"),)),
        Golden({"cell.strain_x": -0.001, "cell.strain_y": 2.0}, (bytes.fromhex("07 17 08 ffff ffff 4000 0000"),)),
    )
    golden_outputs = (
        Golden(
            {"cell.voltage_x": 60.0, "cell.voltage_y": -20.0},
            (bytes.fromhex("07 17 0000 0004 0064 0002 04 2ee0 f060"),),
        ),
        Golden(
            {"cell.voltage_x": 163.835, "cell.voltage_y": -163.84},
            (bytes.fromhex("07 17 0000 0004 0064 0002 04 7fff 8000"),),
        ),
    )

    def peer(self):
        return UnitPeer(TcpWire())

    def garbage(self):
        """As answers under the right number, and as bytes that are no frame at all."""
        draw = random.Random(21)
        return [*super().garbage()[:30], *(Raw(draw.randbytes(draw.randint(1, 64))) for _ in range(15))]


class TestModbusRtu(BusDriverContract):
    driver = Modbus
    wrong_identity = MappingProxyType({"units": units(word_order="little", identity=ANOTHER)})
    out_of_range = (163.8376, -163.8426, 1e300)
    golden_inputs = (
        Golden({"cell.strain_x": 12.345, "cell.strain_y": -0.5}, (bytes.fromhex("07 17 08 3039 0000 0000 bf00 1138"),)),
    )
    golden_outputs = (
        Golden(
            {"cell.voltage_x": 60.0, "cell.voltage_y": -20.0},
            (bytes.fromhex("07 17 0000 0004 0064 0002 04 2ee0 f060 ea70"),),
        ),
        Golden(
            {"cell.voltage_x": 163.835, "cell.voltage_y": -163.84},
            (bytes.fromhex("07 17 0000 0004 0064 0002 04 7fff 8000 eea2"),),
        ),
    )

    def peer(self):
        return RtuPeer(PtyWire())
