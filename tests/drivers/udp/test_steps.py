"""What arrives at the device of a driver `udp`: never a step, whatever is lost, late or overtaken on the way."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from micromanip_drivers.udp.driver import Udp
from micromanip_drivers.udp.options import UdpOptions

from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.errors import ConfigError
from micromanip.rt.bus_image import DOWN

from .bench import PATIENT_CYCLES, PERIOD_NS, SILENT_CYCLES, Bench, options

pytestmark = [pytest.mark.compiled_only, pytest.mark.xdist_group("udp")]  # compiled by one worker, not by each

STEP_V = 2.0
RESOLVED_V = 2e-4
NEVER = 99


class Wire:
    """Between driver and device: some datagrams never arrive, answers may take some cycles."""

    def __init__(self, bench):
        self.bench, self.voltages, self.on_the_way, self.cycle = bench, [0.0], [], 0

    def pass_cycle(self, wanted, arrives=True, answer_cycles=0):
        """The loop wants a voltage; the code of the exchange."""
        for due in [each for each in self.on_the_way if each[0] <= self.cycle]:
            self.bench.device.sendto(due[1], self.bench.controller)
            self.on_the_way.remove(due)
        code = self.bench.exchange(wanted, 0)
        for count, voltage, _ in self.bench.arrived():
            if not arrives:
                continue
            self.voltages.append(voltage)
            self.bench.acted_on = count
            if answer_cycles != NEVER:
                self.on_the_way.append((self.cycle + 1 + answer_cycles, self.bench.datagram()))
        self.cycle += 1
        return code

    @property
    def largest_step_V(self):
        return max((abs(b - a) for a, b in zip(self.voltages, self.voltages[1:], strict=False)), default=0.0)


@pytest.fixture
def wire():
    with Bench(step_V=STEP_V) as bench:
        yield Wire(bench.follow())


def test_a_short_break_while_the_loop_moves_on_makes_no_step(wire):
    for k in range(10):
        assert wire.pass_cycle(2.0 * k) == 0
    assert wire.voltages[-1] == pytest.approx(18.0)
    for k in range(PATIENT_CYCLES - 1):
        assert wire.pass_cycle(20.0 + 2.0 * k, arrives=False) == 0
    for _ in range(60):
        assert wire.pass_cycle(60.0) == 0
    assert wire.largest_step_V <= STEP_V + RESOLVED_V
    assert wire.voltages[-1] == pytest.approx(60.0)
    assert wire.bench.statistics["held_back"] > 10


@pytest.mark.parametrize("off_cycles", [10, 14, SILENT_CYCLES - 1])
def test_a_device_that_was_away_shortly_is_given_nothing_that_it_may_have_lost(wire, off_cycles):
    """It was switched off and on: it has its safe values again, and says so at its first answer, which is too late."""
    for k in range(24):
        wire.pass_cycle(2.0 * k)
    assert wire.voltages[-1] == pytest.approx(46.0)
    for _ in range(off_cycles):
        wire.pass_cycle(46.0, arrives=False)
    wire.voltages[:], wire.bench.count = [0.0], 0
    codes = [wire.pass_cycle(46.0) for _ in range(SILENT_CYCLES)]
    assert codes[-1] == DOWN
    assert wire.voltages == [0.0]


def test_answers_that_come_late_let_it_go_on_from_where_it_was(wire):
    for k in range(10):
        wire.pass_cycle(2.0 * k)
    before = len(wire.voltages)
    codes = [wire.pass_cycle(18.0 + 2.0 * k, answer_cycles=SILENT_CYCLES - 4) for k in range(SILENT_CYCLES - 4)]
    assert len(wire.voltages) == before + PATIENT_CYCLES + 1  # the answer to the last of the ten is there
    codes += [wire.pass_cycle(60.0) for _ in range(40)]
    assert set(codes) == {0}
    assert wire.largest_step_V <= STEP_V + RESOLVED_V
    assert wire.voltages[-1] == pytest.approx(60.0)


def test_answers_that_say_nothing_new_are_silence(wire):
    """The device speaks, and acts on nothing that it is sent: its samples are good, its outputs are lost."""
    codes, before = [], int(wire.bench.signals[0]["sequence"])
    for _ in range(SILENT_CYCLES + 2):
        codes.append(wire.pass_cycle(10.0, arrives=False))
        wire.bench.device.sendto(wire.bench.datagram(), wire.bench.controller)
    assert codes[-1] == DOWN
    assert wire.bench.signals[0]["sequence"] - before >= SILENT_CYCLES
    assert wire.voltages[-1] == 0.0


def test_a_count_of_another_time_acknowledges_nothing(wire):
    for ago in (70, 1000, 30_000, 65_000):
        sent = int(wire.bench.c["gate"]["sent_count"])
        wire.bench.acted_on = (sent - ago) % 65536
        known = int(wire.bench.c["gate"]["acknowledged"])
        wire.bench.device.sendto(wire.bench.datagram(), wire.bench.controller)
        wire.bench.exchange(1.0, 0)
        assert wire.bench.c["gate"]["acknowledged"] == known


def test_until_the_limits_are_told_nothing_moves():
    with Bench(step_V=0.0) as bench:
        wire = Wire(bench.follow())
        for _ in range(5):
            assert wire.pass_cycle(1.0) == 0
        assert set(wire.voltages) == {0.0}
        bench.driver.adopt(bench.context, [SafeOutput(VOLTAGE, 0.0, -20, 150, 1e9), SafeOutput(VOLTAGE, 1.0)])
        wire.pass_cycle(1.0)
        assert wire.voltages[-1] == pytest.approx(1.0)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-20, 150), st.booleans(), st.sampled_from([0, 0, 0, 1, 2, 7, NEVER])),
        min_size=30,
        max_size=120,
    )
)
def test_whatever_is_lost_late_or_overtaken_nothing_steps(cycles):
    with Bench(step_V=STEP_V) as bench:
        wire = Wire(bench.follow())
        for wanted, arrives, answer_cycles in cycles:
            wire.pass_cycle(wanted, arrives, answer_cycles)
        assert wire.largest_step_V <= STEP_V + RESOLVED_V
        assert all(math.isfinite(voltage) for voltage in wire.voltages)


def test_a_counter_that_could_be_taken_for_an_older_one_is_refused():
    number = {"at": 22, "type": "uint8"}
    keys = options(4840).model_dump()
    keys["receive"]["acknowledges"], keys["send"]["counter"] = number, {"at": 2, "type": "uint8"}
    keys["silence_ms"], keys["watchdog"]["ms"] = 20, 50
    with pytest.raises(ConfigError, match="begins anew after 256 datagrams, 200 of which"):
        Udp(UdpOptions.model_validate(keys), PERIOD_NS)
