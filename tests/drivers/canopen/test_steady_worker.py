"""A worker whose turns compiled code takes, with CANopen nodes: it follows, loses a node, comes back at rest."""

import itertools

import pytest

from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules
from micromanip.rt.bus_image import EPOCH, FOLLOWING, RESTING

from ..running_worker import RunningWorker
from .cell import cell

pytestmark = [pytest.mark.live, pytest.mark.compiled_only]

RATE_HZ, STEP_V = 200.0, 10.0
RULES = Rules([SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ)] * 3, 0.1, 300_000_000, 100_000_000)


class Running(RunningWorker):
    @property
    def compiled_pdos(self):
        return self.driver._tables.counted("pdos")

    def turn(self):
        """The nodes have a thread of their own."""


def test_it_follows_rests_and_comes_back():
    with cell() as at, Running(at.driver(), RULES, None) as run:
        at.values["strain_x"] = 12.5
        run.until(lambda: run.state == FOLLOWING, 0.0)
        run.until(lambda: at.values.get("voltage_x") == 80.0 and run.signals[0]["value"] == 12.5, 80.0)
        before = run.compiled_pdos
        run.until(lambda: run.compiled_pdos > before + 20, 80.0)
        statistics = run.driver.statistics()
        assert statistics["lost"] <= 0.1 * statistics["pdos"]
        assert run.driver._receiver.watches["sensor"].operational, "its heartbeats reach Python"

        epoch = run.image.ask(EPOCH)
        at.do(at.nodes["sensor"].stop_heartbeat)
        run.until(lambda: run.image.link == "down", 80.0)
        at.do(at.nodes["sensor"].reboot)
        run.until(lambda: run.image.ask(EPOCH) > epoch and run.state == RESTING, 80.0)
        written = [value for name, value in at.written if name == "voltage_x"]
        assert max(abs(after - value) for value, after in itertools.pairwise(written)) < STEP_V + 0.01
