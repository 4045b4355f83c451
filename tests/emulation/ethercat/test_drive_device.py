"""What `simulate-device` plays of a cell with a drive: the drive moves the plant, and its faults come by command."""

import json
import threading
import time

import numpy as np
import pytest
from micromanip_drivers.ethercat.records import CONTEXT

from micromanip.bus.cyclic import call_context
from micromanip.emulation.devices import Devices
from micromanip.emulation.ethercat.drive import ENABLED, FAULT, SWITCH_ON_DISABLED
from micromanip.rt.records import SIGNAL
from micromanip.settings.check import prepare
from tests.drivers.ethercat.bench import _EXCHANGE
from tools.bus_faults.ethercat_cells import drive_cell

from .wire import until, veth

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]
PERIOD_NS = 2_000_000


class Cell:
    """The devices in a thread, and the driver of the cell, whose cycles the test runs."""

    def __init__(self, file):
        self.devices = Devices(file)
        wiring = prepare(file).wiring
        self.driver = wiring.drivers["cell"]
        self.context = self.driver.context()
        self.driver.adopt(self.context, wiring.safe_outputs("cell", prepare(file).configuration))
        self.signals, self.outputs, self.now_ns = np.zeros(48, SIGNAL), np.zeros(8), time.monotonic_ns()
        self.functions = self.driver.functions()
        self._exchange = _EXCHANGE(self.functions.exchange)
        self.devices.start()
        self._thread = threading.Thread(target=self.devices.loop.run)
        self._thread.start()

    def close(self):
        call_context(self.functions.close, self.context.ctypes.data)
        self.devices.loop.stop()
        self._thread.join()
        self.devices.close()

    def cycle(self, **outputs):
        """One, with these outputs; whether they are followed."""
        for name, value in outputs.items():
            self.outputs[self.driver.outputs.index(name)] = value
        self.now_ns += PERIOD_NS
        at = (self.context.ctypes.data, self.outputs.ctypes.data, self.signals.ctypes.data)
        return self._exchange(*at, self.now_ns, 1) == 0

    def says(self, name):
        return float(self.signals[self.driver.inputs.index(name)]["value"])

    @property
    def drive(self):
        return self.devices.emulated["cell"].slaves.drives[0]

    def order(self, **command):
        assert self.devices.command(json.dumps(command)) == {"ok": True}


def test_the_drive_moves_the_plant_and_what_is_injected_is_heard(tmp_path):
    with veth("ecx") as (here, _):
        text = drive_cell().replace("silence_ms: 50", "silence_ms: 1000").replace("{ms: 300,", "{ms: 3000,")
        file = tmp_path / "cell.yaml"
        file.write_text(text.replace(text.split("interface: ")[1].split()[0], here))
        cell = Cell(file)
        try:
            cell.driver.begin(cell.context)
            assert call_context(cell.functions.open, cell.context.ctypes.data) == 0
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
