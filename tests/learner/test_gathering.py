"""Periods out of the telemetry of a path that repeats: one after the other, until the part ends."""

import numpy as np

from micromanip.control.learned import RECOGNISED_S
from micromanip.learner.gathering import Gathering
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import PART_RUNS, PART_TURN, ROW

PERIOD_S, LOOP_HZ = 2.0, 100
PERIOD = round(PERIOD_S * LOOP_HZ)


def course(begins, ends, cycles):
    rows = np.zeros(cycles, ROW)
    rows["cycle"], rows["state"] = np.arange(cycles), TRACKING
    since = rows["cycle"] >= begins
    rows["lines"] = np.where(since, PART_TURN, 0) | np.where(since & (rows["cycle"] < ends), PART_RUNS, 0)
    return rows


def gathered(rows, batch=7, move_by=0):
    found, said = [], []
    gathering = Gathering(PERIOD_S, 0.0, RECOGNISED_S, 1.0 / LOOP_HZ, repeats=True)
    recognisable = []
    for first in range(0, len(rows), batch):
        said += gathering.add(rows[first : first + batch])
        recognisable += [part.number for part in gathering.recognisable()]
        for part in gathering.whole():
            found.append(part)
            if move_by:
                gathering.move(move_by)
    return found, said, recognisable


def test_each_period_is_one_until_the_part_ends_and_the_last_that_is_not_whole_is_not_told():
    rows = course(300, 300 + 3 * PERIOD + 150, 300 + 6 * PERIOD)
    for batch in (1, 7, 130, len(rows)):
        found, said, recognisable = gathered(rows, batch)
        assert [part.begun for part in found] == [300 + k * PERIOD for k in range(3)]
        assert [part.number for part in found] == [1, 2, 3]
        assert not said
        assert recognisable == [1], "the others follow the first"
        assert all(part.rows["cycle"][-1] >= part.begun + PERIOD - 1 for part in found)


def test_what_really_begins_later_moves_those_that_come():
    found, _, _ = gathered(course(300, 10_000, 300 + 5 * PERIOD), move_by=3)
    apart = np.diff([part.begun for part in found])
    assert (apart == PERIOD + 3).all()


def test_a_loss_of_tracking_ends_it():
    rows = course(300, 10_000, 300 + 5 * PERIOD)
    rows["state"][300 + 2 * PERIOD + 50] = TRACKING + 1
    assert [part.number for part in gathered(rows)[0]] == [1, 2]
