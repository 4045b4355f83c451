"""A worker of a serial line whose turns compiled code takes: it follows, rests, loses its link and comes back."""

import struct
from pathlib import Path

import numpy as np
import pytest
from micromanip_drivers.line.driver import Line
from micromanip_drivers.line.options import LineOptions

from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules
from micromanip.rt.bus_image import EPOCH, FOLLOWING, LINK, LINK_UP, RESTING

from ..running_worker import RunningWorker
from .board import AXES, FRAMING, Board, frame
from .wires import PtyWire, TcpWire

pytestmark = [pytest.mark.live, pytest.mark.compiled_only]

RATE_HZ, STEP_V = 1000.0, 2.0
OUTPUTS = [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ)] * 3
NAMES = [f"voltage_{axis}" for axis in AXES]
RULES = Rules(OUTPUTS, 0.1, 300_000_000, 100_000_000)


class Mirror(Board):
    """Its strain is the voltage that it was given last."""

    def understand(self, unit):
        super().understand(unit)
        if unit[3] == 0x20:
            self.inputs["strain_x"] = struct.unpack_from("<h", unit, 6)[0] * 0.005


class Running(RunningWorker):
    def __init__(self, board, memory):
        framing = FRAMING | {"silence_ms": 1000}
        super().__init__(Line(LineOptions(**board.wire.options, **framing), Path()), RULES, memory)
        self.board, self.heard = board, []

    @property
    def record_of_compiled(self):
        return self.driver._framing._line._tables._c

    @property
    def compiled_frames(self):
        """Sent and received without Python since it had its turn last."""
        return min(int(self.record_of_compiled["bytes_out"]), int(self.record_of_compiled["frames"]))

    def turn(self):
        self.heard += [values["voltage_x"] for values in self.board.writes()]

    def has(self, voltage):
        return bool(self.heard) and abs(self.heard[-1] - voltage) < 0.01

    def sees(self, voltage):
        return abs(self.signals[0]["value"] - voltage) < 0.01


@pytest.mark.parametrize("wire", [PtyWire, TcpWire])
def test_it_follows_rests_and_comes_back(wire, tmp_path):
    board = Mirror(wire())
    memory = LastGiven.open("a line", NAMES, tmp_path)
    board.start()
    try:
        with Running(board, memory) as run:
            run.until(lambda: run.state == FOLLOWING, 0.0)
            run.until(lambda: run.has(60.0) and run.sees(60.0), 60.0)
            run.until(lambda: run.compiled_frames > 5, 60.0)
            assert run.image.known(1) == [60.0]

            not_ours = run.driver.statistics()["not_ours"]
            board.send(b"\xaa\x55\x01garbage" + frame(0x77, b"another kind"))
            run.until(lambda: run.driver.statistics()["not_ours"] > not_ours, 60.0)
            run.until(lambda: run.compiled_frames > 5, 60.0)

            run.until(lambda: run.state == RESTING and run.has(0.0))  # the loop is silent
            run.until(lambda: run.compiled_frames > 5)

            run.until(lambda: run.state == FOLLOWING, 0.0)
            run.until(lambda: run.has(40.0), 40.0)
            epoch = run.image.ask(EPOCH)
            board.kill()
            run.until(lambda: run.image.ask(LINK) != LINK_UP, 40.0)
            assert np.abs(np.diff(run.heard)).max() < STEP_V + 0.01, "nothing jumps"
            board.start()
            run.until(lambda: run.image.ask(EPOCH) > epoch and run.state == RESTING and run.has(0.0), 40.0)
            run.until(lambda: run.compiled_frames > 5)
            assert np.abs(np.diff(run.heard)).max() < STEP_V + 0.01, "no break lets anything jump"
    finally:
        board.kill()
        memory.close()
