"""The safe state: every value in range and within a step of the last one, a ramp to rest, and rest only when given."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.driver import Task
from micromanip.bus.safe_state import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE, Beginning, Left, SafeOutput, SafeState
from micromanip.rt.bus_image import FOLLOWING, RESTING, SAFE_RAMP
from micromanip.rt.io import gate as law
from micromanip.rt.jit import plain

may_have_moved, note_sent, note_taken = map(plain, (law.may_have_moved, law.note_sent, law.note_taken))

MS = 1_000_000
PERIOD_S, RAMP_S, DEAD_NS = 0.01, 0.5, 5 * MS
SLEW_V_PER_S = 1000.0
STEP_V = SLEW_V_PER_S * PERIOD_S
TURNS = round(RAMP_S / PERIOD_S)
VOLT, ENABLE, FEED_HOLD, SPARE = ALL = range(4)
OUTPUTS = (
    SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, SLEW_V_PER_S),
    SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0),
    SafeOutput(SWITCH, 1.0, 0.0, 1.0),
    SafeOutput(UNUSED, 0.25),
)


class Gate(SafeState):
    """Each output is written by a task of its own."""

    def __init__(self, outputs, periods_s, ramp_s, dead_ns):
        tasks = [Task(str(i), 1.0 / period_s, (i,)) for i, period_s in enumerate(periods_s)]
        super().__init__(outputs, tasks, ramp_s, dead_ns)

    def decided(self, *wanted):
        self.decide(*wanted)
        return self.values

    def attempted(self, indices, values):
        for i in indices:
            self.fields["value"][i] = values[i]
            note_sent(self.fields, i, 0, 0)

    def given(self, indices, values):
        self.attempted(indices, values)
        for i in indices:
            assert note_taken(self.fields, i, 0)
            assert not note_taken(self.fields, i, 0), "once"

    def read_back(self, values):
        for i, value in enumerate(values):
            if value is not None:
                self.begin(i, Beginning(value, (value, value)))

    def rests_with(self, values):
        for i, value in enumerate(values):
            self.fields["value"][i] = value
        return self.rests


class Device:
    """What is given to a device that takes, or does not take, what it is sent; the loop is alive unless told so."""

    def __init__(self, outputs=OUTPUTS, ramp_s=RAMP_S, period_s=PERIOD_S):
        self.state = Gate(outputs, [period_s] * len(outputs), ramp_s, DEAD_NS)
        self.has = []

    def turn(self, wanted=77.0, alive=True, takes=True):
        """One task; what was sent."""
        values = self.state.decided([wanted, 1.0, 0.0, 9.0][: len(self.state.last)], 0, 0 if alive else DEAD_NS + 1)
        if takes:
            self.state.given(range(len(values)), values)
            self.has.append(values)
        return values

    def volts(self, *args, **kwargs):
        return self.turn(*args, **kwargs)[VOLT]

    def follow(self, wanted):
        """Up to `wanted`, in the loop's hand."""
        for _ in range(100):
            voltage = self.volts(wanted if self.state.state == FOLLOWING else 0.0)
            if self.state.state == FOLLOWING and voltage == wanted:
                return self
        raise AssertionError("it does not follow")

    @property
    def steps(self):
        return [abs(later[VOLT] - earlier[VOLT]) for earlier, later in itertools.pairwise(self.has)]


@pytest.fixture
def device():
    return Device()


def test_at_rest_until_the_loop_asks_for_rest(device):
    assert device.state.state == SAFE_RAMP  # the device was given nothing yet
    assert device.turn(40.0) == [0, 0, 1, 0.25]
    assert device.state.state == RESTING
    assert device.turn(40.0) == [0, 0, 1, 0.25]
    assert device.turn(0.0) == [0, 1, 0, 0.25]
    assert device.state.state == FOLLOWING
    assert device.turn(10.0) == [10, 1, 0, 0.25]


def test_rest_is_what_the_device_was_given_not_what_was_decided(device):
    for _ in range(5):
        device.turn(0.0, takes=False)
    assert device.state.state == SAFE_RAMP
    device.follow(40.0)
    device.state.leave()
    for _ in range(10 * TURNS):
        device.turn(takes=False)
    assert device.state.state == SAFE_RAMP
    assert device.state.last[VOLT] == 40.0


def test_each_output_must_have_been_given(device):
    values = device.state.decided([0.0, 1.0, 0.0, 0.0], 0, 0)
    device.state.given([VOLT, FEED_HOLD], values)
    assert device.state.state == SAFE_RAMP
    device.state.given([ENABLE], values)
    assert device.state.state == RESTING


def test_a_loop_that_has_never_written_is_not_followed(device):
    for _ in range(5):
        assert device.turn(0.0, alive=False)[ENABLE] == 0
    assert device.state.state == RESTING


def test_a_dead_loop_is_a_ramp_to_rest_amplifier_last(device):
    device.follow(80.0)
    first = device.turn(80.0, alive=False)
    assert first[VOLT] == pytest.approx(80.0, abs=0.01)
    assert first[ENABLE:] == [1, 1, 0.25]  # the machine stops feeding at once
    assert device.state.state == SAFE_RAMP
    for _ in range(TURNS // 2 - 1):
        value = device.turn(80.0, alive=False)
    assert value[VOLT] == pytest.approx(40.0)
    for _ in range(TURNS // 2):
        value = device.turn(80.0, alive=False)
    assert value == [0, 1, 1, 0.25]
    assert device.turn(80.0, alive=False) == [0, 0, 1, 0.25]  # then the amplifier goes off
    assert device.state.state == RESTING


def test_the_loop_lives_or_is_dead_by_the_age_of_what_it_wrote(device):
    device.turn(40.0)
    assert device.state.state == RESTING
    device.state.decided([0.0, 1.0, 0.0, 9.0], 7 * DEAD_NS, 8 * DEAD_NS)
    assert device.state.state == FOLLOWING
    assert device.state.decided([5.0, 1.0, 0.0, 9.0], 7 * DEAD_NS, 8 * DEAD_NS) == [5, 1, 0, 0.25]
    device.state.decided([5.0, 1.0, 0.0, 9.0], 7 * DEAD_NS, 8 * DEAD_NS + 1)
    assert device.state.state == SAFE_RAMP


def test_outputs_at_rest_stay_there_when_the_loop_dies(device):
    device.turn(40.0)
    device.turn(40.0)
    device.state.decided([40.0, 1.0, 0.0, 9.0], 0, DEAD_NS + 1)
    assert device.state.state == RESTING


def test_a_loop_is_dead_after_its_time_and_not_before(device):
    assert not device.state.is_dead(7, 6 + DEAD_NS)
    assert not device.state.is_dead(7, 7 + DEAD_NS)
    assert device.state.is_dead(7, 8 + DEAD_NS) is True


def test_it_is_not_followed_again_before_it_asks_for_rest(device):
    device.follow(80.0)
    device.state.leave()
    for _ in range(TURNS + 5):
        device.turn(1e-6)
    assert device.state.state == RESTING
    assert device.volts(80.0) == 0.0
    assert device.turn(0.0)[ENABLE] == 1
    assert device.state.state == FOLLOWING


def test_rest_is_asked_for_by_the_safe_value_and_by_nothing_else():
    device = Device((replace(OUTPUTS[VOLT], safe=10.0), *OUTPUTS[1:]))
    device.state.remember([10.0, 0.0, 1.0, None])
    for wanted in (-10.0, 0.0, 10.1):
        device.turn(wanted)
        device.turn(wanted)
        assert device.state.state == RESTING
    assert device.turn(10.0 + 1e-10)[ENABLE] == 1
    assert device.state.state == FOLLOWING


def test_what_differs_by_a_nanovolt_is_rest(device):
    device.state.given(ALL, [1e-9, 0.0, 1.0, 0.25])
    assert device.state.state == RESTING
    device.turn(1e-9)
    assert device.state.state == FOLLOWING


def test_outputs_that_the_loop_itself_has_at_rest_stay_in_its_hand(device):
    device.follow(0.0)
    values = device.state.decided([0.0, 0.0, 1.0, 9.0], 0, 0)
    device.state.given(ALL, values)
    assert (values, device.state.state) == ([0, 0, 1, 0.25], FOLLOWING)


def test_what_nobody_uses_is_given_its_safe_value_whatever_it_had(device):
    device.state.remember([60.0, 0.0, 1.0, 7.0])
    assert device.turn(takes=False)[SPARE] == 0.25, "on the ramp as well"
    device.state.remember([0.0, 0.0, 1.0, 7.0])
    values = device.turn(0.0, takes=False)
    device.state.given([VOLT, ENABLE, FEED_HOLD], values)
    assert device.state.state == RESTING
    assert device.turn(0.0)[SPARE] == 0.25
    assert device.state.state == FOLLOWING


def test_which_outputs_are_not_at_rest(device):
    assert device.state.unsafe == [VOLT, ENABLE, FEED_HOLD]
    device.turn()
    assert device.state.unsafe == []
    device.follow(40.0)
    assert device.state.unsafe == [VOLT, ENABLE, FEED_HOLD]


def test_the_voltages_rest_where_they_were_taken_and_nothing_else_comes_next(device):
    safe = [0.0, 1.0, 0.0, 9.0]
    assert not device.state.rests_with(safe), "nothing is known of them"
    device.follow(0.0)
    assert device.state.rests_with(safe) is True, "the switches are the loop's"
    assert not device.state.rests_with([0.1, 1.0, 0.0, 9.0])
    assert not device.state.rests_with([-0.1, 1.0, 0.0, 9.0])
    device.state.attempted([VOLT], [0.1, 1.0, 0.0, 9.0])
    assert not device.state.rests_with(safe), "that may have arrived"
    device.turn(0.0)
    assert device.state.rests_with([1e-9, 1.0, 0.0, 9.0])
    device.state.leave()
    assert not device.state.rests_with(safe)


def test_the_voltages_rest_at_a_safe_value_of_their_own():
    device = Device((replace(OUTPUTS[VOLT], safe=10.0), *OUTPUTS[1:]))
    device.state.remember([10.0, None, None, None])
    device.turn(0.0)
    assert device.state.rests_with([10.0, 0.0, 0.0, 0.0])
    assert not device.state.rests_with([-10.0, 0.0, 0.0, 0.0])
    assert not device.state.rests_with([0.0, 0.0, 0.0, 0.0])


def test_a_break_in_the_middle_of_the_ramp_costs_nothing(device):
    device.follow(80.0)
    device.state.leave()
    for _ in range(TURNS // 2):
        device.turn()
    device.state.leave()
    for _ in range(TURNS // 2 + 2):
        device.turn()
    assert device.state.state == RESTING


def test_the_loop_is_followed_no_faster_than_the_slew_limit(device):
    device.follow(0.0)
    assert [device.volts(35.0) for _ in range(5)] == [10, 20, 30, 35, 35]
    assert [device.volts(0.0) for _ in range(4)] == [25, 15, 5, 0]


def test_a_ramp_that_is_too_short_for_the_slew_limit_takes_longer():
    device = Device(ramp_s=1e-10).follow(45.0)
    device.state.leave()
    assert [device.volts() for _ in range(6)] == [35, 25, 15, 5, 0, 0]


def test_where_a_value_may_have_arrived_or_not_the_next_is_near_to_both(device):
    device.follow(40.0)
    sent = device.turn(50.0, takes=False)
    device.state.attempted(ALL, sent)
    assert device.volts(90.0, takes=False) == 50.0
    assert device.volts(0.0, takes=False) == 40.0
    assert device.volts(43.0) == 43.0
    assert device.volts(90.0) == 53.0


def test_a_value_that_may_have_arrived_is_no_rest(device):
    device.follow(5.0)
    device.state.leave()
    for _ in range(TURNS - 1):
        device.turn()
    device.state.attempted(ALL, [2.0, 0.0, 1.0, 0.25])
    device.state.given([ENABLE, FEED_HOLD], [0.0, 0.0, 1.0, 0.25])
    assert device.state.state == SAFE_RAMP
    device.turn()
    device.turn()
    assert device.state.state == RESTING


@pytest.mark.parametrize("arrived", [50.0, 70.0])
def test_who_takes_over_sends_the_last_value_again(device, arrived):
    """The one before may have sent one value more before it was killed: 10 V more or less."""
    device.state.remember([60.0, 1.0, 0.0, None])
    device.has.append([arrived])
    assert device.turn(60.0) == [pytest.approx(60.0), 1.0, 1.0, 0.25]
    for _ in range(TURNS):
        device.turn(60.0)
    assert max(device.steps) <= STEP_V + 1e-9
    assert device.turn(60.0) == [0.0, 0.0, 1.0, 0.25]
    assert device.state.state == RESTING


def test_what_was_remembered_is_known_and_what_was_not_is_not(device):
    assert all(map(math.isnan, device.state.last))
    device.state.remember([60.0, None, 0.0, None])
    assert device.state.last[VOLT] == 60.0
    assert math.isnan(device.state.last[ENABLE])
    device.turn()
    assert not any(map(math.isnan, device.state.last))


def test_how_an_output_was_left():
    """What anybody said that it was given, and what its register may have from here."""
    switch, first = SafeOutput(SWITCH, 1.0, 0.0, 1.0), SafeOutput(VOLTAGE, 10.0, -20.0, 150.0, SLEW_V_PER_S)
    tasks = [Task("other", 0.5 / PERIOD_S, (2,)), Task("one", 1.0 / PERIOD_S, (0, 1))]
    state = SafeState((switch, first, first), tasks, RAMP_S, DEAD_NS, [1.0, 5.0, 6.0])
    nobody = (math.inf, -math.inf)
    known = {"kind": VOLTAGE, "rest": 5.0, "safe": 10.0, "step": STEP_V, "last": 10.0}
    untouched = Left(**known | {"rest": 6.0, "step": 2 * STEP_V}, given=None, register=nobody)
    assert [state.left(1), state.left(2)] == [Left(**known, given=None, register=nobody), untouched]
    assert SafeState((first,), [Task("alone", 1.0, (0,))], RAMP_S, DEAD_NS).left(0).rest == 10.0
    state.remember([0.0, 60.0, None])
    assert state.left(0) == Left(SWITCH, 1.0, 1.0, math.inf, 0.0, (0.0, 0.0), (0.0, 0.0))
    assert state.left(1) == Left(**known | {"last": 60.0}, given=(50.0, 70.0), register=(50.0, 70.0))
    state.fields["value"][1] = 75.0
    note_sent(state.fields, ONE, 1000, 1002)
    assert state.left(1) == Left(**known | {"last": 60.0}, given=(50.0, 75.0), register=(50.0, 75.0))
    assert note_taken(state.fields, ONE, 1003)
    assert [state.silent_ns(i, 2000) for i in (1, 2)] == [(997, 1000), (997, 2000)]
    for volts in (45.0, 46.0):
        state.fields["value"][0], state.fields["value"][1] = 1.0, volts
        note_sent(state.fields, ONE, 1000, 1002)
    assert state.left(0).register == (0.0, 1.0)
    assert state.left(1).register == (45.0, 75.0)
    assert note_taken(state.fields, ONE, 1003)
    taken = Left(**known | {"last": 46.0}, given=(46.0, 46.0), register=(46.0, 46.0))
    state.assume_safe(where_unknown=True)
    assert state.left(1) == taken
    assert state.left(2) == replace(untouched, given=(10.0, 10.0))
    state.assume_safe()
    assert state.left(1) == Left(**known, given=(10.0, 10.0), register=(-math.inf, math.inf))
    assert state.left(0).last == 1.0, "a person spoke of voltages"


@pytest.mark.parametrize("off_V", [0.0, 8.0, -8.0, STEP_V, STEP_V + 0.1])
def test_a_ramp_goes_on_from_where_it_is_as_if_nothing_had_been(off_V):
    """And begins anew from what is further away than a step, whatever may have been sent; the others' go on."""
    outputs = [OUTPUTS[VOLT], replace(OUTPUTS[VOLT], slew_V_per_s=1e6), OUTPUTS[VOLT]]
    state, unbroken = (Gate(outputs, [PERIOD_S] * 3, RAMP_S, DEAD_NS) for _ in range(2))
    for each in (state, unbroken):
        each.read_back([80.0] * 3)
        for _ in range(TURNS // 2):
            each.given(range(3), each.decided([0.0] * 3, 0, 0))
    for more in (3.0, -3.0):
        state.attempted([2], [0.0, 0.0, state.last[2] + more])
    state.leave()
    found = unbroken.last[2] + off_V
    state.read_back([None, None, found])
    expected, values = unbroken.decided([0.0] * 3, 0, 0), state.decided([0.0] * 3, 0, 0)
    assert values[:2] == expected[:2]
    if abs(off_V) > STEP_V:
        assert found - 0.1 < values[2] <= found
    else:
        assert values[2] == min(max(expected[2], found - STEP_V), found + STEP_V)


@pytest.mark.parametrize(("safe", "found"), [(10.0, 13.0), (10.0, 7.0), (-10.0, -13.0), (-10.0, STEP_V - 10.0)])
def test_what_is_within_a_step_of_rest_is_not_led_away_from_it(safe, found):
    device = Device((replace(OUTPUTS[VOLT], safe=safe), *OUTPUTS[1:]), period_s=PERIOD_S)
    device.state.read_back([safe + 70.0, None, None, None])
    while device.state.last[VOLT] - found > 0.9 * STEP_V:
        device.turn()
    device.state.read_back([found, None, None, None])
    assert min(found, safe) <= device.volts() <= max(found, safe)


def test_what_was_remembered_last_counts(device):
    device.state.remember([60.0, None, None, None])
    device.state.remember([58.0, None, None, None])
    device.state.fields["lowest"][VOLT] = device.state.fields["highest"][VOLT] = 58.0
    assert 57.9 < device.volts() <= 58.0


def test_a_link_that_breaks_again_and_again_costs_the_ramp_nothing(device):
    """Also near to its end, where what is there is where the device may have gone by itself."""
    device.follow(80.0)
    device.state.leave()
    for turn in range(TURNS + 2):
        if turn % 5 == 0:
            device.state.leave()
            device.state.read_back([device.state.last[VOLT], None, None, None])
        device.turn()
    assert device.state.state == RESTING


def test_a_device_that_went_to_rest_by_itself_is_not_moved_again(device):
    device.follow(80.0)
    device.state.leave()
    device.state.read_back([0.0, 0.0, 0.0, None])
    for _ in range(5):
        assert device.volts(80.0) == pytest.approx(0.0, abs=1e-12)
    assert device.state.state == RESTING


@pytest.mark.parametrize(("found", "bound"), [(200.0, 150.0), (-70.0, -20.0)])
def test_a_voltage_beyond_the_range_begins_at_the_nearest_bound(device, found, bound):
    assert device.state.outside([found, None, 1.0, None]) == [VOLT]
    with pytest.raises(ValueError, match="longer"):
        device.state.outside([found])
    device.state.read_back([found, None, None, None])
    assert device.volts() == pytest.approx(bound, abs=0.02)
    again = Device()
    again.state.remember([found, None, None, None])
    assert again.volts() == pytest.approx(bound, abs=0.02)


@pytest.mark.parametrize("end", [-20.0, 150.0])
def test_the_ends_of_the_range_belong_to_it(device, end):
    assert device.state.outside([end, None, None, None]) == []
    device.follow(end)
    assert device.state.refused == 0


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 150.1, -20.1])
def test_a_value_that_may_not_be_sent_keeps_the_one_before(device, wrong):
    device.follow(80.0)
    assert device.turn(wrong) == [80, 1, 0, 0.25]
    assert device.state.refused == 1


def test_what_is_not_finite_is_not_sent_even_without_a_range():
    device = Device((replace(OUTPUTS[VOLT], low=-math.inf, high=math.inf), *OUTPUTS[1:])).follow(80.0)
    assert device.volts(math.inf) == 80.0
    assert device.state.refused == 1


def test_new_limits_hold_from_the_next_value_on(device):
    device.follow(30.0)
    device.state.adopt((SafeOutput(VOLTAGE, 0.0, -20.0, 60.0, 200.0), *OUTPUTS[1:]), 2 * RAMP_S, 2 * DEAD_NS)
    assert device.volts(59.0) == 32.0
    assert device.volts(61.0) == 32.0
    assert not device.state.is_dead(0, 2 * DEAD_NS)
    assert device.state.is_dead(0, 2 * DEAD_NS + 1)
    device.state.leave()
    turns = 0
    while device.state.state == SAFE_RAMP:
        device.turn()
        turns += 1
    assert turns == 2 * TURNS + 1


def test_a_bus_without_voltages_rests_as_soon_as_it_was_given_its_values():
    device = Device((SafeOutput(SWITCH, 1.0, 0.0, 1.0), SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0)))
    assert device.turn() == [1.0, 0.0]
    assert device.state.state == RESTING


def test_a_bus_with_nothing_to_bring_to_rest_rests():
    for outputs in ((), (SafeOutput(UNUSED, 0.25),)):
        state = Gate(outputs, [PERIOD_S] * len(outputs), RAMP_S, DEAD_NS)
        assert state.state == RESTING
        state.decided([9.0] * len(outputs), 0, 0)
        state.leave()
        assert state.state == RESTING


def test_voltages_of_tasks_of_their_own_ramp_each_at_its_rate():
    outputs = [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, SLEW_V_PER_S)] * 2
    state = Gate(outputs, [PERIOD_S, 2 * PERIOD_S], RAMP_S, DEAD_NS)
    state.read_back([80.0, 80.0])
    for turn in range(TURNS):
        values = state.decided([0.0, 0.0], 0, 0)
        state.given([0] if turn % 2 else [0, 1], values)
    assert values == [0.0, pytest.approx(0.0, abs=0.1)]
    assert state.state == RESTING


def test_an_output_of_any_place_is_limited_and_led_to_rest():
    """Two voltages behind a switch, a spare output and an amplifier's enable."""
    state = Gate([OUTPUTS[i] for i in (FEED_HOLD, SPARE, VOLT, ENABLE, VOLT)], [PERIOD_S] * 5, RAMP_S, DEAD_NS)

    def turn(first, second, age_ns=0):
        values = state.decided([0.0, 9.0, first, 1.0, second], 0, age_ns)
        state.given(range(5), values)
        return values

    assert [turn(0.0, 0.0) for _ in range(2)][1] == [0.0, 0.25, 0.0, 1.0, 0.0]
    assert turn(60.0, 30.0) == [0.0, 0.25, 10.0, 1.0, 10.0]
    for _ in range(5):
        turn(60.0, 30.0)
    first = turn(60.0, 30.0, DEAD_NS + 1)
    assert first == [1.0, 0.25, pytest.approx(60.0, abs=0.01), 1.0, pytest.approx(30.0, abs=0.01)]


def test_a_task_is_judged_by_its_own_outputs():
    tasks = [Task("far", 1.0 / PERIOD_S, (0,)), Task("near", 1.0 / PERIOD_S, (1,))]
    state = SafeState([OUTPUTS[VOLT]] * 2, tasks, RAMP_S, DEAD_NS, [RESTS_AT_V, 0.0], BEGINS_NS)
    state.assume_safe()
    assert [may_have_moved(state.fields, task, BEGINS_NS + 1) for task in (0, 1)] == [True, False]


def test_a_task_that_is_held_up_holds_up_no_other():
    state = Gate([OUTPUTS[VOLT]] * 2, [PERIOD_S] * 2, RAMP_S, DEAD_NS)
    state.read_back([80.0, 80.0])
    for _ in range(TURNS // 2):
        values = state.decided([0.0, 0.0], 0, 0)
        state.given([0], values)
    assert values == [pytest.approx(40.0), pytest.approx(80.0, abs=0.01)]


BEGINS_NS, RESTS_AT_V = 100, 30.0
TWO_TASKS = [Task("other", 1.0 / PERIOD_S, (ENABLE, SPARE)), Task("one", 1.0 / PERIOD_S, (VOLT, FEED_HOLD))]
OTHER, ONE = 0, 1


@pytest.fixture
def two_tasks():
    """In the loop's hand, everything at rest; the device's watchdog leads the voltage to 30 V."""
    state = SafeState(OUTPUTS, TWO_TASKS, RAMP_S, DEAD_NS, [RESTS_AT_V, 0.0, 0.0, 0.0], BEGINS_NS)
    for _ in range(2):
        state.decide([0.0, 0.0, 1.0, 0.0], 0, 0)
        for task in (0, 1):
            note_sent(state.fields, task, 0, 0)
            assert note_taken(state.fields, task, 0)
    assert state.state == FOLLOWING
    return state


def of_tasks(state, *names):
    return [(state.fields[name][ONE], state.fields[name][OTHER]) for name in names]


def test_a_task_confirms_what_it_was_sent_itself_and_last(two_tasks):
    g = two_tasks.fields
    two_tasks.decide([5.0, 1.0, 0.0, 0.0], 0, 7)
    assert two_tasks.decided_ns == 7
    note_sent(g, ONE, 1000, 1001)
    two_tasks.decide([8.0, 0.0, 1.0, 0.0], 0, 8)
    note_sent(g, OTHER, 2000, 2002)
    assert of_tasks(two_tasks, "sent_ns", "unconfirmed", "fed_ns") == [(1000, 2000), (1, 1), (0, 0)]
    assert (two_tasks.last, g["touched_ns"][0]) == ([0.0, 0.0, 1.0, 0.25], 2002)
    assert note_taken(g, ONE, 3000)
    assert (two_tasks.last, g["touched_ns"][0]) == ([5.0, 0.0, 0.0, 0.25], 3000)
    assert of_tasks(two_tasks, "unconfirmed", "fed_ns") == [(0, 1), (1000, 0)]
    assert not note_taken(g, ONE, 4000), "it was confirmed already"
    assert note_taken(g, OTHER, 5000)
    assert of_tasks(two_tasks, "unconfirmed", "fed_ns") == [(0, 0), (1000, 2000)]
    assert (two_tasks.last, g["touched_ns"][0]) == ([5.0, 0.0, 0.0, 0.25], 5000)


def test_what_is_sent_may_be_there_until_it_is_confirmed(two_tasks):
    two_tasks.decide([5.0, 1.0, 0.0, 0.0], 0, 0)
    note_sent(two_tasks.fields, OTHER, 0, 0)
    two_tasks.decide([-99.0, 0.0, 0.0, 0.0], 0, 0)
    assert two_tasks.fields["lowest"][VOLT] == two_tasks.fields["highest"][VOLT] == 0.0, "the other task's"
    two_tasks.decide([-5.0, 0.0, 0.0, 0.0], 0, 0)
    note_sent(two_tasks.fields, ONE, 0, 0)
    two_tasks.decide([0.0, 0.0, 0.0, 0.0], 0, 0)
    assert not two_tasks.rests, "it may be at -5 V"
    for volts in (5.0, 0.0):
        two_tasks.decide([volts, 0.0, 0.0, 0.0], 0, 0)
        note_sent(two_tasks.fields, ONE, 0, 0)
    assert (two_tasks.fields["lowest"][VOLT], two_tasks.fields["highest"][VOLT]) == (-5.0, 5.0)
    assert note_taken(two_tasks.fields, ONE, 0)
    assert two_tasks.fields["lowest"][VOLT] == two_tasks.fields["highest"][VOLT] == 0.0


def test_silence_may_have_moved_what_is_further_than_a_step_from_rest(two_tasks):
    g = two_tasks.fields
    within = 40.0 + 5e-10
    for volts, moved in ((19.0, True), (20.0, False), (30.0, False), (within, False), (41.0, True), (49.0, True)):
        for _ in range(3):
            two_tasks.decide([volts, 0.0, 0.0, 0.0], 0, 0)
            note_sent(g, ONE, 500, 600)
            note_taken(g, ONE, 600)
        assert may_have_moved(g, ONE, 500 + BEGINS_NS + 1) == moved
        assert not may_have_moved(g, ONE, 500 + BEGINS_NS), "the watchdog waits so long"
        assert not may_have_moved(g, OTHER, 500 + BEGINS_NS + 1), "its switches go at once"
    g["still"][ONE] = 1
    assert not may_have_moved(g, ONE, 1000), "it has been waited for"
    note_sent(g, OTHER, 500, 600)
    assert not may_have_moved(g, ONE, 1000), "the other task's command"
    note_sent(g, ONE, 500, 600)
    assert may_have_moved(g, ONE, 1000)


def test_what_nobody_knows_may_have_moved():
    tasks = [Task("other", 1.0 / PERIOD_S, (0,)), Task("one", 1.0 / PERIOD_S, (1,))]
    state = SafeState((OUTPUTS[FEED_HOLD], OUTPUTS[VOLT]), tasks, RAMP_S, DEAD_NS, [0.0] * 2, BEGINS_NS)
    assert may_have_moved(state.fields, ONE, BEGINS_NS + 1)
    assert not may_have_moved(state.fields, 0, BEGINS_NS + 1), "a switch goes at once"
    state.assume_safe()
    assert not may_have_moved(state.fields, ONE, BEGINS_NS + 1)


def test_a_device_that_waits_for_nobody_is_not_moved_by_silence():
    assert not may_have_moved(SafeState(OUTPUTS, TWO_TASKS, RAMP_S, DEAD_NS).fields, 0, 10**18)


ACTS = st.lists(
    st.tuples(
        st.sampled_from(["given", "given", "lost, arrived", "lost", "held", "dead", "cut", "killed", "silent"]),
        st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-30, 160)),
    ),
    min_size=1,
    max_size=80,
)


@given(ACTS, st.floats(-20, 150))
def test_whatever_happens_the_device_sees_no_step_and_no_value_out_of_range(acts, begins_at):
    """Answers missing, values held back, deaths of loop and worker, breaks of any length: each step that arrives."""
    has, remembered, state = begins_at, begins_at, None
    for what, wanted in acts:
        if what == "killed" or state is None:
            state = Gate(OUTPUTS, [PERIOD_S] * 4, RAMP_S, DEAD_NS)
            state.remember([remembered, 1.0, 0.0, 0.25])
        if what in ("cut", "silent"):
            state.leave()
        if what == "cut":
            state.read_back([has, None, None, None])
        values = state.decided([wanted, 1.0, 0.0, 0.0], 0, DEAD_NS + 1 if what == "dead" else 0)
        assert -20.0 <= values[VOLT] <= 150.0
        if what == "held":
            continue
        if what not in ("lost", "silent"):
            assert abs(values[VOLT] - has) <= STEP_V + 1e-9
            has = values[VOLT]
        if what in ("lost", "lost, arrived", "silent", "killed"):
            state.attempted(ALL, values)
        else:
            state.given(ALL, values)
            remembered = values[VOLT]
        if state.state == RESTING:
            assert abs(has) <= 1e-9
        else:
            assert state.state in (FOLLOWING, SAFE_RAMP)


@given(st.floats(-20, 150), st.lists(st.booleans(), max_size=200))
def test_the_ramp_goes_towards_rest_and_arrives(begin, taken):
    device = Device()
    device.state.read_back([begin, 1.0, 0.0, None])
    before = begin
    for takes in [*taken, *[True] * (TURNS + 20)]:
        voltage = device.volts(alive=False, takes=takes)
        assert abs(voltage) <= abs(before) + 1e-9
        assert abs(voltage - before) <= STEP_V + 1e-9
        before = voltage if takes else before
    assert device.state.state == RESTING
