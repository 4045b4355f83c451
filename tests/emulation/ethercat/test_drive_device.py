"""What `device simulate` plays of a cell with a drive: the drive moves the plant, and its faults come by command."""

import json
import time

import pytest
from micromanip_drivers.ethercat.records import CONTEXT

from campaigns.fault_cells import drive_cell
from micromanip.emulation.devices import Devices
from micromanip.emulation.ethercat.drive import ENABLED, FAULT, SWITCH_ON_DISABLED
from micromanip.settings.check import prepare
from tests.drivers.called import Called
from tests.testbus.loop_in_thread import LoopInThread

from .wire import until, veth

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]
PERIOD_NS = 2_000_000


class Cell(Called):
    """The devices in a thread, and the driver of the cell, whose cycles the test runs."""

    def __init__(self, file):
        self.devices = Devices(file)
        wiring = prepare(file).wiring
        super().__init__(wiring.drivers["cell"], wiring.safe_outputs("cell", prepare(file).configuration))
        self.asked = self.outputs.copy()
        self.now_ns = time.monotonic_ns()
        self.devices.start()
        self._running = LoopInThread(self.devices.loop)

    def close(self):
        super().close()
        self._running.end()
        self.devices.close()

    def cycle(self, **outputs):
        """One, with these outputs; whether they are followed."""
        for name, value in outputs.items():
            self.asked[self.driver.outputs.index(name)] = value
        self.outputs[:] = self.asked  # the driver leaves there what it gave
        self.now_ns += PERIOD_NS
        return self.exchange_at(self.now_ns) == 0

    def says(self, name):
        return float(self.sample(name)["value"])

    @property
    def drive(self):
        return self.devices.emulated["cell"].slaves.drives[0]

    def order(self, **command):
        assert self._running.ask(lambda: self.devices.command(json.dumps(command))) == {"ok": True}


def test_the_drive_moves_the_plant_and_what_is_injected_is_heard(tmp_path):
    with veth("ecx") as (here, _):
        text = drive_cell().replace("silence_ms: 50", "silence_ms: 1000").replace("{ms: 300,", "{ms: 3000,")
        file = tmp_path / "cell.yaml"
        file.write_text(text.replace(text.split("interface: ")[1].split()[0], here))
        cell = Cell(file)
        try:
            cell.open()
            assert until(cell.cycle)
            assert until(lambda: cell.cycle() and cell.says("amplifier_ok_x") == 1.0)
            assert cell.drive["state"] == SWITCH_ON_DISABLED
            c = cell.context.view(CONTEXT)[0]
            assert until(lambda: cell.cycle(amplifier_enable=1.0) and c["drive"][0]["taken_up"])
            assert cell.drive["state"] == ENABLED
            before_um = cell.says("strain_x")
            assert until(lambda: cell.cycle(voltage_x=40.0) and cell.says("strain_x") > before_um + 10.0)
            assert until(lambda: cell.cycle() and cell.says("position_x") == pytest.approx(40.0, abs=0.1))
            cell.order(inject="fault", terminal="amplifier", code=0x3210, for_s=0.2)
            assert until(lambda: cell.cycle() and cell.says("amplifier_ok_x") == 0.0)
            cell.cycle(voltage_x=0.0, amplifier_enable=0.0)
            assert until(lambda: cell.cycle() and cell.drive["state"] == FAULT and cell.says("position_x") == 0.0)
            assert cell.says("error_code_x") == 0x3210
            cell.order(device="clear")
            cell.cycle(amplifier_reset=1.0)
            assert until(lambda: cell.cycle() and cell.says("amplifier_ok_x") == 1.0)
            answer = cell.devices.command('{"inject": "stuck", "terminal": "gauge"}')
            assert "gauge is no drive" in answer["error"]
        finally:
            cell.close()
