"""The learned correction as it is played: its rows and their derivatives, soft ends, and never more than its limit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.control.learned import fill_learned
from micromanip.rt.laws.learned import LEARNED_PARAMETERS, LEARNED_STATE
from micromanip.rt.laws.reference import REFERENCE_STATES
from micromanip.rt.record import MAX_AXES

from .builders import record
from .kernels import learned_course

LOOP_HZ = 1_000.0
ROWS = 600
COLUMN = 1


def parameters(rows=ROWS, number=1, limit_um=5.0):
    p = record(LEARNED_PARAMETERS)
    fill_learned(p, number, COLUMN, rows, limit_um, LOOP_HZ)
    return p


def course(p, values, cycles, s=None, allowed=None):
    """Position, velocity and acceleration (n, 3) that are added in `cycles`."""
    samples = np.zeros((len(values), MAX_AXES))
    samples[:, COLUMN] = values
    out = np.zeros((len(cycles), REFERENCE_STATES))
    s = record(LEARNED_STATE) if s is None else s
    learned_course(p, s, samples, np.asarray(cycles), np.ones(len(cycles), bool) if allowed is None else allowed, out)
    assert not out[:, 3:].any()
    return out[:, :3]


def wave(hertz=7.0):
    return np.sin(2 * np.pi * hertz * np.arange(ROWS) / LOOP_HZ)


def test_rows_are_played_from_the_cycle_it_was_put_in_force_in_with_their_derivatives():
    p = parameters()
    out, fade = course(p, wave(), 5000 + np.arange(ROWS)), int(p["fade_cycles"])
    inside = slice(fade, ROWS - 1)
    assert out[inside, 0] == pytest.approx(wave()[inside], abs=1e-12)
    omega, time_s = 2 * np.pi * 7.0, np.arange(ROWS)[inside] / LOOP_HZ
    assert out[inside, 1] == pytest.approx(omega * np.cos(omega * time_s), abs=1e-3 * omega)
    assert out[inside, 2] == pytest.approx(-(omega**2) * np.sin(omega * time_s), abs=1e-3 * omega**2)


def test_its_derivatives_are_those_of_what_is_played_while_it_fades_too():
    p = parameters()
    out = course(p, np.ones(ROWS), np.arange(ROWS + 200))
    for position, derivative in ((0, 1), (1, 2)):
        found = np.gradient(out[:, position], 1 / LOOP_HZ)
        scale = np.abs(out[:, derivative]).max()
        assert out[2:-2, derivative] == pytest.approx(found[2:-2], abs=0.1 * scale)


def test_it_begins_and_ends_at_zero_without_a_step_and_ends_after_the_part():
    p = parameters()
    out, fade = course(p, np.ones(ROWS), np.arange(ROWS + 200)), int(p["fade_cycles"])
    assert out[0, 0] < 1e-3
    assert np.abs(np.diff(out[:, 0])).max() < 2.0 / fade
    assert out[ROWS - 1, 0] == 1.0
    assert not out[ROWS + fade :].any()


def test_a_missed_cycle_shifts_nothing():
    cycles = np.concatenate([np.arange(300), np.arange(307, ROWS)])
    whole = course(parameters(), wave(), np.arange(ROWS))
    assert course(parameters(), wave(), cycles) == pytest.approx(whole[cycles], abs=1e-12)


def test_a_part_that_was_broken_off_fades_out_and_is_not_resumed_but_the_next_one_begins():
    allowed = np.ones(500, bool)
    allowed[300:302] = False
    s = record(LEARNED_STATE)
    out = course(parameters(), np.ones(ROWS), np.arange(500), s, allowed)
    fade = int(parameters()["fade_cycles"])
    assert out[299, 0] == 1.0
    assert np.abs(np.diff(out[:, 0])).max() < 2.0 / fade
    assert not out[300 + fade :].any()
    after = course(parameters(number=2), np.ones(ROWS), np.arange(500, 700), s)
    assert after[-1, 0] == 1.0


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40),
    st.floats(0.01, 50.0),
    st.lists(st.tuples(st.integers(1, 30), st.booleans()), min_size=1, max_size=80),
)
def test_whatever_the_memory_holds_the_limit_is_kept_and_it_comes_to_rest(values, limit_um, steps):
    p, s = parameters(len(values), limit_um=limit_um), record(LEARNED_STATE)
    cycles = np.cumsum([step for step, _ in steps])
    out = course(p, np.array(values), cycles, s, np.array([allowed for _, allowed in steps]))
    assert np.abs(out[:, 0]).max() <= limit_um
    assert np.abs(out[:, 1]).max() <= limit_um * LOOP_HZ
    assert np.isfinite(out).all()
    last = cycles[-1] + len(values) + np.arange(1, 2 * int(p["fade_cycles"]))
    assert not course(p, np.array(values), last, s)[-1].any()
