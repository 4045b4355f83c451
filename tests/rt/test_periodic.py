"""The correction of a path that repeats: round and round, changed at a period's end, and never a step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.control.learned import Played, fill_learned
from micromanip.rt.laws.learned import (
    BROKEN_OFF,
    FINISHED,
    IDLE,
    LEARNED_PARAMETERS,
    LEARNED_STATE,
    OTHER_TOOL,
    PATH_LEFT,
    PLAYS,
    WITHDRAWN,
)
from micromanip.rt.laws.reference import REFERENCE_STATES
from micromanip.rt.record import MAX_AXES

from .builders import record
from .kernels import periodic_course

LOOP_HZ = 1_000.0
ROWS = 400
COLUMN = 2
FADING = 1.875
"""The largest slope of minimum jerk."""
TURN = np.arange(ROWS) / ROWS


class Loop:
    """A loop that plays of a table with two places, each with its path."""

    def __init__(self, values, path=0.0, limit_um=5.0, search_s=0.05, begun=1000):
        self.rows = len(values)
        self.samples = np.zeros((4 * self.rows, MAX_AXES))
        self.limits = Played(limit_um, 1.0, search_s, repeats=True)
        self.p, self.s = record(LEARNED_PARAMETERS), record(LEARNED_STATE)
        self.s["part_begun"], self.s["part"] = begun, -self.rows
        self.number, self.cycle = 0, begun
        self.hold(values, path, begun)

    def hold(self, values, path=0.0, begun=None):
        self.number += 1
        first = self.number % 2 * 2 * self.rows
        self.samples[first : first + self.rows, COLUMN] = values
        self.samples[first + self.rows : first + 2 * self.rows, COLUMN] = path
        begun = self.p["begun_cycle"] if begun is None else begun
        fill_learned(self.p, self.number, COLUMN, 2 * self.rows, self.limits, LOOP_HZ, first)
        self.p["begun_cycle"] = begun

    def run(self, cycles, reference=0.0, allowed=True, at=None):
        """Position, velocity and acceleration (n, 3) that are added in the next `cycles`."""
        at = self.cycle + np.arange(cycles) if at is None else np.asarray(at)
        out = np.zeros((len(at), REFERENCE_STATES))
        out[:, 0] = reference
        periodic_course(self.p, self.s, self.samples, at, np.broadcast_to(allowed, len(at)), out)
        self.cycle = int(at[-1]) + 1
        return out[:, :3] - np.array([1.0, 0.0, 0.0]) * np.broadcast_to(reference, len(at))[:, None]

    @property
    def fade(self):
        return int(self.p["fade_cycles"])


def wave(turns=3):
    return np.sin(2 * np.pi * turns * TURN + 0.4)


def test_it_goes_round_and_round_with_its_derivatives_and_its_end_is_none():
    it = Loop(wave())
    out, k = it.run(3 * ROWS), np.arange(3 * ROWS)
    inside, omega = slice(it.fade, None), 2 * np.pi * 3 * LOOP_HZ / ROWS
    assert out[inside, 0] == pytest.approx(wave()[k % ROWS][inside], abs=1e-12)
    assert out[inside, 1] == pytest.approx(omega * np.cos(2 * np.pi * 3 * k / ROWS + 0.4)[inside], abs=2e-3 * omega)
    assert out[inside, 2] == pytest.approx(-(omega**2) * wave()[k % ROWS][inside], abs=2e-3 * omega**2)
    assert it.s["why"] == PLAYS
    assert it.s["part"] == 1000 + 2 * ROWS


def test_what_is_learned_meanwhile_is_taken_over_at_the_end_of_the_period_without_a_step():
    it = Loop(wave())
    it.run(ROWS + 100)
    it.hold(2.0 * np.cos(2 * np.pi * TURN))
    rest = it.run(ROWS - 100)[:, 0]
    assert rest == pytest.approx(wave()[100:], abs=1e-12), "the old one, to its end"
    assert it.s["number"] == 1
    after = it.run(ROWS)
    assert it.s["number"] == 2
    assert after[it.fade :, 0] == pytest.approx(2.0 * np.cos(2 * np.pi * TURN)[it.fade :], abs=1e-12)
    both = np.concatenate([rest, after[:, 0]])
    between = 2 * np.pi * 3 / ROWS + FADING * 3.0 / it.fade
    assert np.abs(np.diff(both)).max() < between
    assert after[1:-1, 1] == pytest.approx(np.gradient(after[:, 0], 1 / LOOP_HZ)[1:-1], abs=1e-6)


def test_it_follows_a_period_that_is_a_little_longer_than_was_said():
    it = Loop(wave())
    it.run(ROWS)
    it.p["begun_cycle"] += ROWS + 3
    it.run(ROWS)
    late = it.run(ROWS)[:, 0]
    assert it.s["begun_cycle"] == 1000 + 2 * ROWS + 3
    assert late[2 * it.fade :] == pytest.approx(np.roll(wave(), 3)[2 * it.fade :], abs=1e-12)
    it.p["begun_cycle"] -= 5
    it.run(ROWS)
    assert it.run(ROWS)[2 * it.fade :, 0] == pytest.approx(np.roll(wave(), -2)[2 * it.fade :], abs=1e-12)


@pytest.mark.parametrize(
    ("why", "change", "again"),
    [
        (PATH_LEFT, {"reference": 1.5}, True),
        (PATH_LEFT, {"reference": np.nan}, True),
        (BROKEN_OFF, {"allowed": False}, True),
        (WITHDRAWN, {"number": 0}, False),
        (OTHER_TOOL, {"other_tool": 1}, False),
        (FINISHED, {"part_begun": -1}, False),
        (FINISHED, {"part_begun": 1000 + ROWS + 150}, False),
    ],
)
def test_what_ends_it_ends_it_at_once_and_softly_and_not_before_the_next_period_it_begins_again(why, change, again):
    it = Loop(np.ones(ROWS))
    before = it.run(ROWS + 150)
    assert before[-1, 0] == 1.0
    moment = {name: change[name] for name in ("reference", "allowed") if name in change}
    for name in change.keys() - moment.keys():
        (it.s if name in it.s.dtype.names and name != "number" else it.p)[name] = change[name]
    first = it.run(2, **moment)
    assert it.s["why"] == why
    rest = it.run(ROWS - 153)
    added = np.concatenate([before, first, rest])[:, 0]
    added = added[np.isfinite(added)]
    assert np.abs(np.diff(added)).max() < 2.0 / it.fade * (2 if np.isnan(change.get("reference", 0.0)) else 1)
    assert not rest[it.fade :].any()
    assert it.run(ROWS)[-1, 0] == float(again)


def test_nothing_is_played_before_it_is_known_of_this_part_when_its_periods_begin():
    it = Loop(np.ones(ROWS), begun=5000)
    for begun in (-1, 5000 - 51):
        it.p["begun_cycle"] = begun
        assert not it.run(2 * ROWS).any()
    assert it.s["why"] == IDLE
    it.p["begun_cycle"] = 5000 - 40
    assert it.run(ROWS)[-1, 0] == 1.0
    assert (it.s["part"] - 5000 + 40) % ROWS == 0


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60),
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60),
    st.floats(0.01, 50.0),
    st.lists(st.tuples(st.integers(0, 200), st.sampled_from(["hold", "late", "miss", "break", "run"])), max_size=12),
)
def test_whatever_is_held_and_whenever_it_stays_within_its_limit_and_makes_no_step(one, other, limit_um, deeds):
    """Two places with anything in them: no step but those of the memories' own rows, and of fading."""
    rows = max(len(one), len(other))
    tables = [np.resize(np.array(each), rows) for each in (one, other)]
    it = Loop(tables[0], limit_um=limit_um)
    own = max(np.abs(np.diff(np.clip(np.append(t, t[0]), -limit_um, limit_um))).max() for t in tables)
    may = own + 3.0 * FADING * limit_um / it.fade + 1e-9 * limit_um
    last = 0.0
    for cycles, deed in deeds:
        if deed == "hold" and ((it.s["changed"] == 1.0 and it.s["number"] == it.number) or not it.s["level"]):
            it.hold(tables[it.number % 2])
        elif deed == "late":
            it.p["begun_cycle"] += cycles
        elif deed == "miss":
            it.cycle += cycles
        at = it.cycle + np.arange(cycles + 1)
        out = it.run(0, at=at, allowed=deed != "break")
        assert np.isfinite(out).all()
        assert np.abs(out[:, 0]).max() <= limit_um * (1 + 1e-12)
        steps = np.abs(np.diff(out[:, 0], prepend=out[0, 0] if deed == "miss" else last))
        assert steps.max() <= may
        last = out[-1, 0]
