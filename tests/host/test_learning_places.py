"""A path that repeats is played to without a stop: its next memory comes where the loop does not read."""

import numpy as np
import pytest

from micromanip.host.learning.correction import Correction, Memories
from micromanip.rt.laws.learned import FINISHED, IDLE, LEARNED_STATE, PLAYS
from micromanip.settings.check import prepare
from micromanip.settings.commissioned import tuning_hash
from tests.cells import simulated


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "cell.yaml"
    file.write_text(simulated() + "learning: {seconds: 2.0, repeats: true}\n")
    return prepare(file)


@pytest.fixture
def correction(prepared):
    return Correction(prepared, prepared.configuration.learning, np.zeros_like(prepared.samples))


def hold(correction, prepared, value):
    tunings = {name: tuning_hash(axis) for name, axis in prepared.configuration.axes.items()}
    correction.hold(
        Memories(np.full((correction.rows, correction._table.shape[1]), value), tunings, dict.fromkeys(tunings, 1))
    )
    return correction.added(prepared, prepared.parameters)[0]["axis"]["learned"][: len(tunings)]


def test_two_memories_lie_beside_each_other_and_take_turns(correction, prepared):
    assert len(correction._table) == 2 * correction.rows == 4 * 20_000
    first, second, third = (hold(correction, prepared, value).copy() for value in (0.1, 0.2, 0.3))
    assert {*first["first"], *second["first"]} == {0, correction.rows}
    assert (first["first"] == third["first"]).all()
    assert third["number"].tolist() == [3, 3, 3]
    assert (correction._table[third["first"][0] :][: correction.rows] == 0.3).all()
    assert (correction._table[second["first"][0] :][: correction.rows] == 0.2).all()
    assert third["repeats"].all()
    candidate = correction.added(prepared, prepared.parameters, candidate=True)[0]["axis"]["learned"]
    assert not candidate["number"].any()


def test_what_periods_begin_is_kept_from_memory_to_memory(correction, prepared):
    correction.recognised("y", 45_001)
    assert hold(correction, prepared, 0.1)["begun_cycle"].tolist() == [-1, 45_001, -1]


@pytest.mark.parametrize(
    ("change", "free"),
    [
        ({}, True),
        ({"number": 1}, False),  # it plays the one before, to the end of its period
        ({"changed": 0.9}, False),  # and fades out of it yet
        ({"why": FINISHED, "number": 1}, False),  # and so it does where the part has ended
        ({"why": FINISHED, "number": 1, "level": 0.0}, True),
        ({"why": IDLE, "number": 0, "level": 0.0}, True),
    ],
)
def test_a_memory_waits_until_the_loop_plays_the_last_one_alone(correction, prepared, change, free):
    for value in (0.1, 0.2):
        hold(correction, prepared, value)
    states = np.zeros(3, LEARNED_STATE)
    states["why"], states["number"], states["level"], states["changed"] = PLAYS, 2, 1.0, 1.0
    for name, value in change.items():
        states[name][1] = value
    assert correction.may_hold(np.array([2, 2, 0]), states) is free
    assert not correction.may_hold(np.array([2, 1, 0]), states), "the set that is in force is older"
