"""The learned correction as it is played: its rows and their derivatives, soft ends, and never more than its limit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host.learning.handover import FADE_S, fill_learned
from micromanip.rt.axis_order import AXIS_ORDER
from micromanip.rt.laws.learned import (
    BROKEN_OFF,
    IDLE,
    LEARNED_PARAMETERS,
    LEARNED_STATE,
    OTHER_TOOL,
    PART_ENDED,
    PATH_LEFT,
    PLAYS,
    WITHDRAWN,
)
from micromanip.rt.laws.reference import REFERENCE_STATES
from micromanip.rt.record import MAX_AXES
from micromanip.settings.schema.learning import Learning

from .builders import record
from .kernels import learned_course

LOOP_HZ = 1_000.0
ROWS = 600
COLUMN = 1


def parameters(rows=ROWS, limit_um=5.0):
    p = record(LEARNED_PARAMETERS)
    learning = Learning(seconds=2.0, limit_um=limit_um, tolerance_um=1.0)
    fill_learned(p, 1, COLUMN, 2 * rows, learning, LOOP_HZ)
    return p


def state(part_begun):
    s = record(np.dtype([("law", LEARNED_STATE), ("order", AXIS_ORDER)], align=True))
    s["order"]["part_begun"], s["law"]["part"] = part_begun, -1  # a loop's first cycle is 1
    return s


def course(p, values, cycles, s=None, allowed=None, path=0.0, reference=0.0):
    """Position, velocity and acceleration (n, 3) that are added in `cycles` to `reference`, beside a `path`."""
    cycles = np.asarray(cycles)
    samples = np.zeros((2 * len(values), MAX_AXES))
    samples[: len(values), COLUMN], samples[len(values) :, COLUMN] = values, path
    out = np.zeros((len(cycles), REFERENCE_STATES))
    out[:, 0] = reference
    s = state(cycles[0]) if s is None else s
    learned_course(
        p, s["law"], s["order"], samples, cycles, np.ones(len(cycles), bool) if allowed is None else allowed, out
    )
    assert not out[:, 3:].any()
    return out[:, :3] - np.array([1.0, 0.0, 0.0]) * np.broadcast_to(reference, len(cycles))[:, None]


def wave(hertz=7.0):
    return np.sin(2 * np.pi * hertz * np.arange(ROWS) / LOOP_HZ)


def test_rows_are_played_from_the_first_cycle_of_the_part_on_with_their_derivatives():
    p = parameters()
    out, fade = course(p, wave(), 5000 + np.arange(ROWS)), int(p["fade_cycles"])
    inside = slice(fade, ROWS - 1)
    assert out[inside, 0] == pytest.approx(wave()[inside], abs=1e-12)
    omega, time_s = 2 * np.pi * 7.0, np.arange(ROWS)[inside] / LOOP_HZ
    assert out[inside, 1] == pytest.approx(omega * np.cos(omega * time_s), abs=1e-3 * omega)
    assert out[inside, 2] == pytest.approx(-(omega**2) * np.sin(omega * time_s), abs=1e-3 * omega**2)


def test_it_begins_and_ends_at_zero_without_a_step_and_ends_after_the_part():
    p = parameters()
    out, fade = course(p, np.ones(ROWS), np.arange(ROWS + 200)), int(p["fade_cycles"])
    assert out[0, 0] < 1e-3
    assert np.abs(np.diff(out[:, 0])).max() < 2.0 / fade
    assert out[ROWS - 1, 0] == 1.0
    assert not out[ROWS + fade :].any()


def test_a_part_that_was_broken_off_fades_out_and_is_not_resumed_but_the_next_one_begins():
    allowed = np.ones(500, bool)
    allowed[300:302] = False
    s = state(0)
    out = course(parameters(), np.ones(ROWS), np.arange(500), s, allowed)
    assert s["law"]["why"] == BROKEN_OFF
    fade = int(parameters()["fade_cycles"])
    assert out[299, 0] == 1.0
    assert np.abs(np.diff(out[:, 0])).max() < 2.0 / fade
    assert not out[300 + fade :].any()
    s["order"]["part_begun"] = 500
    after = course(parameters(), np.ones(ROWS), np.arange(500, 700), s)
    assert after[-1, 0] == 1.0


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40),
    st.floats(0.01, 50.0),
    st.lists(st.tuples(st.integers(1, 30), st.booleans()), min_size=1, max_size=80),
)
def test_whatever_the_memory_holds_the_limit_is_kept_and_it_comes_to_rest(values, limit_um, steps):
    p = parameters(len(values), limit_um=limit_um)
    cycles = np.cumsum([step for step, _ in steps])
    s = state(cycles[0])
    out = course(p, np.array(values), cycles, s, np.array([allowed for _, allowed in steps]))
    assert np.abs(out[:, 0]).max() <= limit_um
    assert np.abs(out[:, 1]).max() <= limit_um * LOOP_HZ
    assert np.isfinite(out).all()
    last = cycles[-1] + len(values) + np.arange(1, 2 * int(p["fade_cycles"]))
    assert not course(p, np.array(values), last, s)[-1].any()


LEFT = np.where(np.arange(ROWS) < 300, 0.4 * np.sin(np.arange(ROWS)), 1.5)


@pytest.mark.parametrize(
    ("why", "reference", "at_300"),
    [
        (PATH_LEFT, LEFT, {}),
        (PATH_LEFT, np.where(LEFT > 1.0, np.nan, LEFT), {}),
        (WITHDRAWN, 0.0, {"number": 0}),
        (WITHDRAWN, 0.0, {"number": 2}),
        (PART_ENDED, 0.0, {"part_begun": -1}),
        (PART_ENDED, 0.0, {"part_begun": 300}),
        (OTHER_TOOL, 0.0, {"other_tool": 1}),
    ],
)
def test_what_ends_a_correction_in_mid_part_ends_it_softly_and_says_why(why, reference, at_300):
    """Of the same form as its own end: no faster, and begun in the very cycle."""
    p, s, fade = parameters(), state(0), round(FADE_S * LOOP_HZ)
    both = np.broadcast_to(reference, ROWS)
    before = course(p, np.ones(ROWS), np.arange(300), s, reference=both[:300])
    assert s["law"]["why"] == PLAYS
    for name, value in at_300.items():
        (p if name == "number" else s["order"])[name] = value
    after = course(p, np.ones(ROWS), np.arange(300, 300 + fade + 2), s, reference=both[300 : 300 + fade + 2])
    added = np.nan_to_num(np.concatenate([before, after])[:, 0], nan=0.0)
    assert s["law"]["why"] == why or at_300.get("part_begun") == 300
    assert np.abs(np.diff(np.concatenate([before[:, 0], after[np.isfinite(after[:, 0]), 0]]))).max() < 2.0 / fade
    assert added[299] == 1.0
    assert added[299 + fade] == pytest.approx(0.0, abs=1e-6)


def test_nothing_begins_with_another_tool_than_the_memorys():
    s = state(0)
    s["order"]["other_tool"] = 1
    assert not course(parameters(), np.ones(ROWS), np.arange(300), s).any()
    assert s["law"]["why"] == IDLE


@pytest.mark.parametrize(("late", "begins"), [(0, True), (99, True), (101, False)])
def test_nothing_begins_later_in_its_part_than_another_fades_out(late, begins):
    s = state(1000)
    out = course(parameters(), np.ones(ROWS), 1000 + late + np.arange(200), s)
    assert out.any() == begins
    assert s["law"]["why"] == (PLAYS if begins else IDLE)
