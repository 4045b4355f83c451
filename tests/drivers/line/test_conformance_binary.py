"""The framing `binary` on a pseudo terminal, against the contract of bus drivers."""

import pytest
from micromanip_drivers.line.driver import Line

from micromanip.driver.conformance import BusDriverContract, Golden

from .board import FRAMING, Board
from .compiled_line import CompiledLine
from .wires import PtyWire

pytestmark = pytest.mark.realtime  # the contract judges time-outs, silence and load

ANOTHER = {
    "binary": {
        **FRAMING["binary"],
        "identity": {
            **FRAMING["binary"]["identity"],
            "numbers": {"serial_number": {"at": 4, "type": "uint32", "byte_order": "little", "value": 1235}},
        },
    }
}


class TestBinaryOnPty(BusDriverContract):
    driver = Line
    wrong_identity = ANOTHER
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
            {"voltage_x": 60.0, "voltage_y": -20.0, "voltage_z": 0.005},
            (bytes.fromhex("aa55 0820 e02e 60f0 0100"),),
        ),
        Golden(
            {"voltage_x": 150.0, "voltage_y": 0.0, "voltage_z": -0.005},
            (bytes.fromhex("aa55 0820 3075 0000 ffff"),),
        ),
    )

    def peer(self):
        return Board(PtyWire())


@pytest.mark.compiled_only
class TestCompiledBinaryOnPty(TestBinaryOnPty):
    """The same of the compiled functions."""

    driver = CompiledLine
    test_killed_in_mid_write = None  # each of its processes loads a compiler
