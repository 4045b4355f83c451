"""The framing `ascii` with the preset gcs, over TCP, against the contract of bus drivers."""

import pytest
from micromanip_drivers.line.driver import Line

from micromanip.driver.conformance import BusDriverContract, Golden

from .gcs_controller import FRAMING, GcsController
from .wires import TcpWire

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

ANOTHER = {"ascii": {**FRAMING["ascii"], "identity": "Physik Instrumente.*E-709"}}
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
    wrong_identity = ANOTHER
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
            {"voltage_x": 120.0, "voltage_y": 0.0, "voltage_z": -1.5},
            (b"SVA 1 120.0000 2 0.0000 3 -1.5000\nERR?\n",),
        ),
    )

    def peer(self):
        return TcpGcs(TcpWire())
