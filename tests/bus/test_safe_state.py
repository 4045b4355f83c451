"""The safe state: outputs leave the loop's hand smoothly, and go back to it only where nothing jumps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.io.safe_state import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE, SafeOutput, SafeState
from micromanip.rt.image import FOLLOWING, RESTING, SAFE_RAMP

MS = 1_000_000
RAMP_NS, DEAD_NS = 500 * MS, 5 * MS
OUTPUTS = (
    SafeOutput(VOLTAGE, 0.0, -20.0, 150.0),
    SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0),
    SafeOutput(SWITCH, 1.0, 0.0, 1.0),
    SafeOutput(UNUSED, 0.25),
)


def values(*given):
    return np.array(given, float)


@pytest.fixture
def state():
    state = SafeState(OUTPUTS, RAMP_NS, DEAD_NS)
    state.values(values(0, 0, 0, 9), 0, 0)
    return state


def test_at_rest_until_the_loop_asks_for_rest():
    state = SafeState(OUTPUTS, RAMP_NS, DEAD_NS)
    assert state.values(values(40, 1, 0, 0), 0, MS).tolist() == [0, 0, 1, 0.25]
    assert state.state == RESTING
    assert state.values(values(0, 1, 0, 0), MS, MS).tolist() == [0, 1, 0, 0.25]
    assert state.state == FOLLOWING
    assert state.values(values(40, 1, 0, 0), 2 * MS, 2 * MS).tolist() == [40, 1, 0, 0.25]


def test_a_loop_that_has_never_written_is_not_followed():
    state = SafeState(OUTPUTS, RAMP_NS, DEAD_NS)
    assert state.values(values(0, 1, 0, 0), 0, DEAD_NS + 1).tolist() == [0, 0, 1, 0.25]


def test_a_dead_loop_is_a_ramp_to_rest(state):
    state.values(values(80, 1, 0, 0), MS, MS)
    wanted, at = values(80, 1, 0, 0), MS
    assert state.values(wanted, at, at + DEAD_NS)[0] == 80
    begin = at + DEAD_NS + 1
    assert state.values(wanted, at, begin).tolist() == [80, 1, 1, 0.25]  # the machine stops feeding at once
    assert state.state == SAFE_RAMP
    assert state.values(wanted, at, begin + RAMP_NS // 2).tolist() == [pytest.approx(40), 1, 1, 0.25]
    assert state.values(wanted, at, begin + RAMP_NS).tolist() == [0, 0, 1, 0.25]  # then the amplifier goes off
    assert state.state == RESTING


def test_it_is_not_followed_again_before_it_asks_for_rest(state):
    state.values(values(80, 1, 0, 0), MS, MS)
    state.leave(2 * MS)
    later = 2 * MS + 2 * RAMP_NS
    for wanted in (80.0, 1e-6):
        assert state.values(values(wanted, 1, 0, 0), later, later)[0] == 0
        assert state.state == RESTING
    state.values(values(0, 1, 0, 0), later, later)
    assert state.state == FOLLOWING


def test_the_ramp_runs_by_the_clock(state):
    """A link that is down for longer than the ramp: the first value that can be sent is the safe one."""
    state.values(values(80, 1, 0, 0), MS, MS)
    state.leave(2 * MS)
    assert state.values(values(80, 1, 0, 0), 900 * MS, 900 * MS)[0] == 0


def test_a_worker_that_takes_over_goes_on_from_what_was_sent():
    last, died = values(60, 1, 0, 0.25), 1000 * MS
    state = SafeState(OUTPUTS, RAMP_NS, DEAD_NS, last, died)
    assert state.values(values(60, 1, 0, 0), died, died)[0] == 60
    assert state.values(values(60, 1, 0, 0), died + RAMP_NS // 2, died + RAMP_NS // 2)[0] == pytest.approx(30)
    fresh = SafeState(OUTPUTS, RAMP_NS, DEAD_NS, last, died)
    assert fresh.values(values(60, 1, 0, 0), died + RAMP_NS, died + RAMP_NS)[0] == 0


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 150.1, -20.1])
def test_a_value_that_may_not_be_sent_keeps_the_one_before(state, wrong):
    state.values(values(80, 1, 0, 0), MS, MS)
    assert state.values(values(wrong, 1, 0, 0), 2 * MS, 2 * MS).tolist() == [80, 1, 0, 0.25]
    assert state.refused == 1


STEPS = st.lists(
    st.tuples(st.integers(0, 400), st.floats(allow_nan=True, allow_infinity=True), st.booleans(), st.booleans()),
    min_size=1,
    max_size=60,
)


@given(STEPS)
def test_whatever_happens_the_voltage_is_in_range_and_slow_on_its_own(steps):
    """Random waits, requests, deaths of the loop and of the link: what the state does by itself is never a jump."""
    state, now, written, last = SafeState(OUTPUTS, RAMP_NS, DEAD_NS), 0, 0, 0.0
    for wait_ms, wanted, alive, lost in steps:
        now += wait_ms * MS
        if alive:
            written = now
        if lost:
            state.leave(now)
        before = state.state
        voltage = state.values(values(wanted, 1, 0, 0), written, now)[0]
        assert -20.0 <= voltage <= 150.0
        if before == RESTING or state.state == RESTING:
            assert voltage == 0.0 or state.state == FOLLOWING
        if state.state == SAFE_RAMP:  # towards rest, at most as fast as the ramp is
            assert abs(voltage) <= abs(last) + 1e-9
        if before == RESTING and state.state == FOLLOWING:
            assert abs(voltage) <= 1e-9
        last = voltage
