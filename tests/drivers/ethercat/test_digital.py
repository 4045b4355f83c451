"""Terminals whose process data are bits: lines in and out, a value behind status bits, and what no frames leave."""

import pytest

from micromanip.bus.errors import IdentityMismatch
from micromanip.bus.ethercat.al_states import OP
from micromanip.bus.ethercat.registers import WATCHDOG_COUNT
from micromanip.emulation.ethercat.terminal import DIGITAL_INPUTS, DIGITAL_OUTPUTS, INPUTS
from micromanip.rt.bus_image import DOWN, TAKEN
from tests.emulation.ethercat.wire import veth

from .bench import AMPLIFIER, ANALOGUE, PINS_IN, PINS_OUT, SILENT_CYCLES, STILL_CYCLES, Bench
from .test_line import terminal

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]

TERMINALS = {"amplifier": AMPLIFIER, "pins": PINS_OUT, "analogue": ANALOGUE, "lines": PINS_IN}
REST = (0.0, 1.0, 0.0, 1.0, 0.0)
"""Voltage, feed hold, enable, feed hold's line, lamp."""


@pytest.fixture(scope="module")
def ends():
    with veth("ecb") as ends:
        yield ends


@pytest.fixture
def bench(ends):
    with Bench(ends, terminals=TERMINALS) as bench:
        yield bench.open().until_code(0, *REST)


def pins(bench):
    """What the output terminal puts out, lowest channel first."""
    return f"{bench.line.applications[1].memory[DIGITAL_OUTPUTS]:04b}"[::-1]


def test_each_line_goes_to_its_own_pin(bench):
    assert {application.state for application in bench.line.applications} == {OP}
    seen = []
    for outputs in ((1.0, 1.0, 0.0), (0.0, 0.0, 0.0), (0.0, 1.0, 1.0), (1.0, 0.0, 1.0)):
        assert bench.exchange(0.0, 1.0, *outputs) == 0
        seen.append(pins(bench))
    assert seen == ["1000", "0010", "0001", "1011"], "enable, spare, feed hold (inverted), lamp"


def test_lines_and_a_value_behind_status_bits_are_read(bench):
    wanted = 0b1010_0110
    bench.line.applications[3].memory[DIGITAL_INPUTS] = wanted
    code = (-1234 & 0xFFFF) << 13 | 1 << 6 | 0b10 << 2 | 1 << 1
    memory = bench.line.applications[2].memory
    for i, byte in enumerate(code.to_bytes(4, "little")):
        memory[INPUTS + i] = byte
    for _ in range(2):
        bench.exchange(*REST)
    assert sum(int(bench.sample(f"line_{k}")["value"]) << k for k in range(8)) == wanted
    found = {name: float(bench.sample(name)["value"]) for name in ("underrange", "overrange", "limit_1", "error")}
    assert found == {"underrange": 0.0, "overrange": 1.0, "limit_1": 2.0, "error": 1.0}
    assert bench.sample("temperature")["value"] == pytest.approx(-123.4)


def test_without_frames_the_lines_are_safe_and_stay_so_until_the_loop_asks_for_rest(bench):
    assert bench.exchange(20.0, 0.0, 1.0, 0.0, 1.0) == 0
    assert pins(bench) == "1011"
    bench.meddle = lambda frame: []
    for _ in range(SILENT_CYCLES + 5):
        code = bench.exchange(20.0, 0.0, 1.0, 0.0, 1.0)
    assert code == DOWN
    sent = bench.came
    with bench.lock:
        application, began_ns = bench.line.applications[1], bench.now_ns
        bench.line.tick(began_ns)
        bench.line.controllers[1]["outputs_ns"] = began_ns
        for ms in range(1000):
            bench.line.tick(began_ns + ms * 1_000_000)
        assert pins(bench) == "1011", "the watchdog waits for as long as it was set to"
        for ms in range(1000, 1010):
            bench.line.tick(began_ns + ms * 1_000_000)
        assert application.memory[WATCHDOG_COUNT] == 1
    assert pins(bench) == "0000"
    assert application.state == OP, "a terminal without a processor stays there"
    for _ in range(STILL_CYCLES - SILENT_CYCLES - 40):
        assert bench.exchange(20.0, 0.0, 1.0, 0.0, 1.0) == DOWN
    assert bench.came == sent, "nothing is sent meanwhile"
    bench.meddle = lambda frame: [frame]
    bench.until_code(TAKEN, 20.0, 0.0, 1.0, 0.0, 1.0)
    for _ in range(20):
        assert bench.exchange(20.0, 0.0, 1.0, 0.0, 1.0) == TAKEN
        assert pins(bench) == "0000"
    bench.until_code(0, *REST)


def test_a_terminal_without_a_mailbox_is_held_against_its_eeprom(ends):
    half = {f"channel_{k}": PINS_IN["inputs"][f"channel_{k}"] for k in range(4)}
    slaves = {"lines": terminal(PINS_IN | {"inputs": half})}
    with (
        Bench(ends, slaves=slaves, terminals={"lines": PINS_IN}) as bench,
        pytest.raises(IdentityMismatch, match=r"its inputs are 0x1a00: 0x60000101; .* the terminal has no mailbox"),
    ):
        bench.open()
