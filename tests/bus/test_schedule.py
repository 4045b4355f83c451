"""Tasks on their grids, and how a lost link is tried again."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.backoff import BackOff, RestartLimit
from micromanip.bus.driver import Task
from micromanip.bus.schedule import Schedule


def test_what_was_missed_is_skipped_and_the_grid_is_kept():
    schedule = Schedule([Task("only", 1000)], 0)
    assert schedule.take(0) == 0
    assert schedule.take(3_700_000) == 0  # one turn for the three that are over
    assert schedule.take(3_800_000) is None
    assert (schedule.skipped, schedule.next_ns()) == (2, 4_000_000)


@given(st.lists(st.integers(0, 20_000_000), min_size=1, max_size=50))
def test_never_more_often_than_the_rate(waits):
    schedule, now, done = Schedule([Task("a", 500), Task("b", 2000)], 0), 0, [0, 0]
    for wait in waits:
        now += wait
        while (task := schedule.take(now)) is not None:
            done[task] += 1
    assert done[0] <= now // 2_000_000 + 1
    assert done[1] <= now // 500_000 + 1


def test_the_wait_doubles_up_to_two_seconds():
    back_off = BackOff(random.Random(1))
    waits = [back_off.lost(0.0) for _ in range(9)]
    for k, wait in enumerate(waits):
        assert wait == pytest.approx(min(2.0, 0.05 * 2**k), rel=0.2)
    assert back_off.lost(5.0) == pytest.approx(0.05, rel=0.2)  # a link that held is a new story


def test_five_restarts_in_a_minute_are_enough():
    limit = RestartLimit()
    assert [limit.allows(t) for t in (0, 10, 20, 30, 40, 50)] == [True] * 5 + [False]
    assert limit.allows(60.1)
    assert not limit.allows(61.0)
    assert limit.allows(70.1)


READ, WRITE, SYNC = 0, 1, 2
TASKS = [Task("read", 1000), Task("write", 1000, (0,)), Task("SYNC", 1000, serves_outputs=True)]


def test_what_is_due_at_once_is_written_before_it_is_read():
    schedule = Schedule(TASKS, 0)
    assert [schedule.take(0) for _ in range(4)] == [WRITE, READ, SYNC, None]


def test_nothing_is_read_between_a_failure_and_the_next_write():
    schedule = Schedule([Task("read", 1000), Task("write", 100, (0,))], 0)
    assert [schedule.take(0), schedule.take(0)] == [WRITE, READ]
    schedule.failed(READ)
    assert [schedule.take(now) for now in (1_000_000, 9_000_000)] == [None, None]
    assert schedule.next_ns() == 10_000_000, "nobody turns in a circle meanwhile"
    assert [schedule.take(10_000_000), schedule.take(10_000_000)] == [WRITE, READ]


def test_a_write_that_was_held_back_is_tried_soon_and_never_twice_within_a_period():
    schedule = Schedule([Task("read", 100), Task("write", 100, (0,))], 0)
    assert schedule.take(0) == WRITE
    schedule.held(WRITE, 0)
    assert [schedule.take(500_000), schedule.take(7_000_000), schedule.take(7_000_000)] == [None, WRITE, READ]
    assert schedule.take(16_999_999) == READ
    assert schedule.take(17_000_000) == WRITE


def test_a_task_that_is_passed_over_has_no_turns_to_catch_up_with():
    schedule = Schedule(TASKS, 0)
    assert [schedule.take(5_500_000, {READ}) for _ in range(3)] == [WRITE, SYNC, None]
    assert schedule.take(5_600_000) is None
