"""A path that repeats without a stop: what repeats falls from period to period, and nothing makes a step."""

import numpy as np
import pytest

from micromanip.control.learned import FADE_S
from micromanip.rt.laws.learned import BROKEN_OFF, FINISHED, PLAYS
from micromanip.rt.states import ARM, END_PART, HOLD, TRACKING
from micromanip.rt.telemetry import LEARNED_PLAYS

from .production import BEGIN_S, LOOP_HZ, Production, text
from .turning import PERIOD_S, Turning, played, write_path

pytestmark = pytest.mark.long

V_PER_UM = 3.0
PERIODS = 6


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    made = Turning(tmp_path_factory.mktemp("turned"), 1)
    return made.begin().run(PERIODS * PERIOD_S)


def whys(made):
    return made.cell.state[0]["axis"]["learned"]["why"][:3].tolist()


def since_begin(made):
    rows = np.concatenate(made.rows)
    return rows[rows["cycle"] > round(BEGIN_S * LOOP_HZ)]


def test_what_repeats_falls_and_a_new_run_begins_with_what_was_learned(turned, tmp_path):
    assert not turned.cell.faults()
    assert turned.said == ["READY to learn from part to part"]
    assert whys(turned) == [PLAYS] * 3
    learned = [change["new"] for change in turned.noted if change["key"] == "learning.y"]
    assert [told["part"] for told in learned] == [1, 3, 5], "in between the memory before was played yet"
    (tmp_path / "learned").symlink_to(turned.file.parent / "learned")
    quiet = Turning(tmp_path, None, path=turned.path).begin().run(2.5 * PERIOD_S)
    before, after = quiet.periods_um()[:2]
    assert before[1:].min() > 0.1
    assert after.max() < 0.05
    assert (quiet.cell.state[0]["axis"]["learned"]["number"][:3] > 0).all()


def test_no_period_begins_or_ends_with_a_step(turned, tmp_path):
    without = Turning(tmp_path, 1, path=turned.path, learns=False).begin().run(PERIODS * PERIOD_S)
    rows, plain = since_begin(turned), since_begin(without)
    plays = (rows["axis"]["fresh"][:, :3] & LEARNED_PLAYS) != 0
    first = np.argmax(plays, axis=0) / LOOP_HZ
    assert first == pytest.approx(2 * PERIOD_S, abs=0.01), "the second period was told of too late for it"
    assert plays[round(first.max() * LOOP_HZ) + 1 :].all()
    correction = np.abs(turned.segments.sample_table()[:, :3])
    soft_um = 2.0 * (np.abs(np.diff(correction[: len(correction) // 4], axis=0)).max() + 4e-3 * 0.5 / FADE_S / 10)
    for name, may in (("setpoint_um", soft_um), ("voltage_V", V_PER_UM * soft_um)):
        added = rows["axis"][name][:, :3] - plain["axis"][name][:, :3]
        assert np.abs(added).max() > 0.03
        assert np.abs(np.diff(added, axis=0)).max() < may


def test_a_robot_that_is_slower_than_was_said_is_followed(tmp_path):
    """By .2 ms in 3 s; without following it the fifth period would be wrong by a millisecond, 5 % at 8 Hz."""
    slower = write_path(tmp_path / "path.csv", period_s=PERIOD_S + 2e-4)
    made = Turning(tmp_path, None, path=slower).begin().run(7 * PERIOD_S)
    begun = made.cell.state[0]["axis"]["learned"]["begun_cycle"][:3] - round(BEGIN_S * LOOP_HZ)
    assert begun == pytest.approx(7 * (PERIOD_S + 2e-4) * LOOP_HZ, abs=6), "two periods late at most"
    um = made.periods_um()
    assert um[-1].max() < 0.03
    assert whys(made) == [PLAYS] * 3


def test_the_end_of_the_part_and_a_hold_fade_it_out_and_what_was_not_finished_teaches_nothing(turned):
    generations = dict(turned.keeper._correction.memories.generations)
    parts = turned._process._gathering.parts
    turned.run(0.5, HOLD)
    assert set(whys(turned)) <= {BROKEN_OFF, FINISHED}
    turned.run(3.0, ARM)
    assert turned.cell.state[0]["state"] == TRACKING
    turned.run(0.5, END_PART).run(2.0 * PERIOD_S)
    assert whys(turned) == [FINISHED] * 3 or whys(turned) == [BROKEN_OFF] * 3
    assert not turned.cell.state[0]["axis"]["learned"]["level"].any()
    assert turned.keeper._correction.memories.generations == generations
    assert turned._process._gathering.parts <= parts + 1
    assert not [said for said in turned.said if "not finished" in said]


def test_a_memory_of_a_part_with_an_end_is_not_one_of_a_path_that_repeats(turned, tmp_path):
    (tmp_path / "learned").symlink_to(turned.file.parent / "learned")
    said = Production(tmp_path, text(PERIOD_S, played(turned.path))).said
    assert [each.partition(": ")[2] for each in said] == [
        "this memory is of a path that repeats, learning.repeats says false: learn anew, after `micromanip learn "
        f"reset`; nothing is learned or played of axis {axis}" for axis in "xyz"
    ]  # fmt: skip
