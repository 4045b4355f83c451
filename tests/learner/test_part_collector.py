"""Parts out of the telemetry of a running cell: whole ones, once each, however the rows come."""

import numpy as np
import pytest

from micromanip.learner.part_collector import MadePart, PartCollector
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import PART_RUNS, PART_TURN, ROW, TOOL

SECONDS, LOOP_HZ = 2.0, 100
CYCLES = round(SECONDS * LOOP_HZ)


def course(cycles, *parts):
    """Each of `parts` from its first cycle to its last."""
    rows = np.zeros(cycles, ROW)
    rows["cycle"], rows["state"] = np.arange(cycles), TRACKING
    for begins, ends in parts:
        rows["lines"][begins:] ^= PART_TURN
        rows["lines"][begins:ends] |= PART_RUNS
    return rows


def collected(rows, batch=7):
    collector = PartCollector(SECONDS, 1.0 / LOOP_HZ)
    found = [each for k in range(0, len(rows), batch) for each in collector.add(rows[k : k + batch])]
    return [each for each in found if isinstance(each, MadePart)], [each for each in found if isinstance(each, str)]


@pytest.mark.parametrize("batch", [1, 7, 130, 10_000])
def test_each_part_is_given_once_with_what_is_before_it(batch):
    rows = course(1500, (300, 300 + CYCLES), (300 + CYCLES, 1200))
    parts, said = collected(rows, batch)
    assert [(part.number, part.begun) for part in parts] == [(1, 300), (2, 300 + CYCLES)]
    assert not said
    for part in parts:
        assert part.rows["cycle"].tolist() == list(range(part.begun - LOOP_HZ, part.begun + CYCLES + 10))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({}, "it ended after 1.00 s"),
        ({"state": TRACKING + 1}, "tracking ended after 0.50 s"),
        ({"lines": PART_TURN | PART_RUNS | (3 << TOOL)}, "the tool was changed after 0.50 s"),
    ],
)
def test_a_part_that_ends_before_its_time_is_said_and_not_given(change, why):
    rows = course(1000, (300, 400))
    for name, value in change.items():
        rows[name][350:360] = value
    parts, said = collected(rows)
    assert not parts
    assert said == [f"part 1 was not finished, {why}: nothing is learned from it"]


def test_the_tracker_has_its_time_after_a_part():
    rows = course(1000, (300, 800))
    rows["state"][300 + CYCLES + 5 :] = TRACKING + 1
    parts, said = collected(rows)
    assert (parts, said) == ([], ["part 1 was not finished, tracking ended after 2.05 s: nothing is learned from it"])


def test_rows_before_tracking_was_lost_are_not_of_the_next_part():
    rows = course(1000, (300, 800))
    rows["state"][250:280] = TRACKING + 1
    ((part,), _) = collected(rows)
    assert part.rows["cycle"][0] == 280


def test_missed_rows_are_not_in_a_part_and_do_not_shift_it():
    rows = course(1000, (300, 800))
    ((part,), _) = collected(np.delete(rows, slice(300 + CYCLES - 5, 300 + CYCLES + 20)))
    assert (part.begun, part.rows["cycle"][-1]) == (300, 300 + CYCLES - 6)
