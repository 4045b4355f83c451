"""The loop watches its deadlines and its host: counted, held, ramped, and ended where nobody is left."""

import numpy as np
import pytest

from micromanip.rt.cycle import watch_loop
from micromanip.rt.states import (
    FAULT,
    HOLDING,
    HOLDS,
    HOST_DEAD,
    NO_FAULT,
    OFF,
    OVERRUNS,
    RAMPING,
    READY,
    RESET,
    TRACKING,
)
from micromanip.settings.compile.limits import NEVER

from .bench_cell import BenchCell, parameters

HEARTBEAT_NS = 100_000_000


class Supervised(BenchCell):
    """A cell whose cycles are supervised as in the real loop."""

    def __init__(self):
        record = parameters()
        p = record[0]
        p["heartbeat_ns"], p["overruns_in_a_row"] = HEARTBEAT_NS, 3
        p["overrun_share"], p["overrun_level"] = 0.001, 10.0
        p["reaction"][OVERRUNS] = p["reaction"][HOST_DEAD] = HOLDS
        super().__init__(record)
        self.heard_ns = None

    def begin_cycle(self, missed):
        super().begin_cycle(missed)
        watch_loop(self.p, self.s, self.now_ns - (self.now_ns if self.heard_ns is None else self.heard_ns), missed)

    def cycle(self, missed=0):
        self.step(periods=1 + missed)
        return int(self.s["state"])

    def cycles(self, count):
        return [self.cycle() for _ in range(count)]


@pytest.fixture(scope="module")
def tracking():
    return Supervised().arm()


@pytest.fixture
def cell(tracking):
    return tracking.copy()


@pytest.mark.many_cycles
def test_deadlines_in_time_are_nothing(cell):
    assert set(cell.cycles(500)) == {TRACKING}
    assert (cell.s["overruns"], cell.s["overrun_level"], cell.s["events"]) == (0, 0.0, 0)


@pytest.mark.parametrize("missed", [[3], [1, 1, 1], [2, 1], [400]])
def test_three_missed_in_a_row_are_a_hold_in_that_cycle(cell, missed):
    states = [cell.cycle(count) for count in missed]
    assert states == [TRACKING] * (len(missed) - 1) + [HOLDING]
    assert (cell.s["fault"], cell.s["fault_value"], cell.s["fault_limit"]) == (OVERRUNS, sum(missed), 3.0)
    assert cell.s["overruns"] == sum(missed)
    assert cell.s["fault_cycle"] == cell.s["event"][0]["cycle"] == cell.s["cycle"]  # that of the row that shows it
    after = cell.cycles(400)
    assert after[-1] == FAULT
    assert [state for k, state in enumerate(after) if k == 0 or state != after[k - 1]] == [HOLDING, RAMPING, FAULT]


@pytest.mark.many_cycles
def test_two_missed_now_and_then_are_counted(cell):
    """More of them than the bucket holds, but it leaks faster: two in 250 cycles of a hundredth each."""
    cell.p["overrun_share"] = 0.01
    for _ in range(6):
        assert cell.cycle(2) == TRACKING
        assert set(cell.cycles(250)) == {TRACKING}
    assert cell.s["overruns"] == 12


def test_more_than_a_thousandth_in_a_second_is_a_hold(cell):
    """A bucket that leaks by the allowed share: eleven in a burst of single ones overflow it."""
    states = []
    for _ in range(11):
        states += [cell.cycle(1), *cell.cycles(5)]
    assert HOLDING in states
    assert cell.s["fault"] == OVERRUNS
    assert 10.0 < cell.s["fault_value"] < 11.0
    assert cell.s["fault_limit"] == 10.0


def test_reset_empties_the_bucket(cell):
    cell.cycle(50)
    cell.cycles(400)
    assert cell.step(RESET)
    assert set(cell.cycles(200)) == {READY}


def test_without_limits_a_stall_is_only_counted(cell):
    cell.p["overruns_in_a_row"], cell.p["overrun_share"], cell.p["overrun_level"] = NEVER, 0.0, np.inf
    assert cell.cycle(3000) == TRACKING
    assert (cell.s["overruns"], cell.s["fault"]) == (3000, NO_FAULT)


@pytest.mark.many_cycles
def test_host_dead_is_held_ramped_and_ended(cell):
    cell.heard_ns = cell.now_ns
    alive = HEARTBEAT_NS // 100_000
    assert set(cell.cycles(alive)) == {TRACKING}
    states = cell.cycles(400)
    assert states[0] == HOLDING
    assert [state for k, state in enumerate(states) if k == 0 or state != states[k - 1]] == [HOLDING, RAMPING, OFF]
    assert cell.s["fault"] == HOST_DEAD
    assert cell.s["fault_value"] == pytest.approx(100.1)
    assert cell.voltages == [0.0, 0.0, 0.0]


def test_host_dead_at_rest_ends_at_once():
    cell = Supervised()
    cell.run(5)
    cell.heard_ns = cell.now_ns - 2 * HEARTBEAT_NS
    assert cell.cycle() == OFF


def test_a_host_that_comes_back_finds_the_loop_ending(cell):
    """What has begun to end ends: a host that was away may not know what has happened meanwhile."""
    cell.heard_ns = cell.now_ns - 2 * HEARTBEAT_NS
    cell.cycle()
    cell.heard_ns = None
    assert cell.cycles(400)[-1] == OFF
