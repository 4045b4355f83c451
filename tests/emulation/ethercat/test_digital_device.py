"""What `device simulate` plays of a cell whose lines are pins of digital terminals."""

import re

import pytest

from campaigns.fault_cells import ethercat_cell
from micromanip.bus.cyclic import call_context
from micromanip.bus.ethercat.al_states import OP, SAFEOP, WATCHDOG
from micromanip.bus.ethercat.registers import AL_CODE, WATCHDOG_SM
from micromanip.emulation.ethercat.controller import number, put_number
from micromanip.emulation.ethercat.terminal import DIGITAL_OUTPUTS

from .test_drive_device import Cell
from .wire import until, veth

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]

CELL = ethercat_cell()
LOCK = "    lock: {time_constant_ms: 100, within_us: 150}\n"
ENABLE = "              amplifier_enable: {index: 0x7001, subindex: 1, type: uint8, switch: true}\n"
STATE = CELL[CELL.index("        inputs:\n          state:") : CELL.index("      gauge:")]
PINS = """\
      pins:
        vendor: 0x4d4d
        product: 0x1010
        outputs:
          channel_1: {pdo: 0x1600, fields: {lamp: {index: 0x7000, subindex: 1, type: bool, spare: true}}}
          channel_2: {pdo: 0x1601, fields: {amplifier_enable: {index: 0x7010, subindex: 1, type: bool, switch: true}}}
        inputs:
          channel_3: {pdo: 0x1a00, fields: {door: {index: 0x6000, subindex: 1, type: bool, spare: true}}}
          channel_4: {pdo: 0x1a01, fields: {amplifier_ok_x: {index: 0x6010, subindex: 1, type: bool}}}
      gauge:
"""


@pytest.fixture
def cell(tmp_path):
    text = CELL.replace(LOCK, "").replace(ENABLE, "").replace(STATE, "").replace("      gauge:\n", PINS)
    with veth("ecy") as (here, _):
        file = tmp_path / "cell.yaml"
        text = re.sub("interface: .*", f"interface: {here}", text)
        file.write_text(text.replace("silence_ms: 50", "silence_ms: 140"))
        made = Cell(file)
        try:
            made.driver.begin(made.context)
            assert call_context(made.functions.open, made.context.ctypes.data) == 0
            assert until(made.cycle)
            yield made
        finally:
            made.close()


def test_the_pins_carry_the_lines_of_the_cell_and_are_off_without_frames(cell):
    terminals = cell.devices.emulated["cell"].slaves
    pins = terminals.controllers[1]["memory"]
    assert until(lambda: cell.cycle(amplifier_enable=1.0) and pins[DIGITAL_OUTPUTS] == 0b10)
    assert until(lambda: cell.cycle() and cell.says("amplifier_ok_x") == 1.0)
    assert until(lambda: cell.cycle(voltage_x=5.0) and cell.says("strain_x") > 2.0)
    assert until(lambda: pins[DIGITAL_OUTPUTS] == 0), "no frames come"
    assert terminals.applications[1].state == OP, "it has no processor that could leave OP"


class Turns:
    """Counts Python's turns among the terminals."""

    def __init__(self, upkeep):
        self.turn, self.count = upkeep._turn, 0

    def __call__(self):
        self.count += 1
        self.turn()


@pytest.fixture
def turns(cell, monkeypatch):
    """While compiled code serves the line."""
    upkeep = cell.devices.emulated["cell"]._upkeep
    made = Turns(upkeep)
    monkeypatch.setattr(upkeep, "_turn", made)
    assert until(lambda: (cell.cycle(amplifier_enable=1.0), upkeep._serves)[1])
    return made


@pytest.mark.usefixtures("turns")
def test_a_terminal_that_outputs_pass_by_leaves_op_while_others_are_served(cell):
    slaves = cell.devices.emulated["cell"].slaves
    amplifier, memory = slaves.applications[0], slaves.controllers[0]["memory"]
    assert amplifier.state == OP
    cell.order(inject="absent", terminal="amplifier")
    assert until(lambda: (cell.cycle(), cell.devices.emulated["cell"]._upkeep._serves)[1])
    put_number(memory, WATCHDOG_SM, 2, 100)  # of .1 ms: it runs out before the driver says that the link is lost
    assert until(lambda: (cell.cycle(), amplifier.state == SAFEOP)[1])
    assert number(memory, AL_CODE, 2) == WATCHDOG


def test_who_speaks_by_standard_input_is_heard_between_two_frames(cell, turns):
    """Commands come there; its descriptor is 0, as is what nobody has set. Pytest has a file there, always readable."""
    loop, heard = cell.devices.loop, []
    loop.add_reader(0, lambda: heard.append(turns.count))
    try:
        assert until(lambda: (cell.cycle(), len(heard) > 100)[1])
    finally:
        loop.remove_reader(0)
    assert len(set(heard)) < 20, "it is not heard only when Python has its turn anyway"
