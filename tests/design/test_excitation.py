"""Excitation stays inside what it is given: range, slew, band; and is the same for the same seed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design.excitation import (
    IDENTIFICATION_HZ,
    IDENTIFICATION_SHARE,
    multisine,
    random_turns,
    shrinking_triangle,
    soft,
)

RATE_HZ = 1000.0


@given(low=st.floats(-100.0, 100.0), span=st.floats(1.0, 200.0), slew=st.floats(10.0, 1e6), seed=st.integers(0, 1000))
def test_multisine_keeps_range_and_slew(low, span, slew, seed):
    wave = multisine(low, low + span, slew, RATE_HZ, 4.0, seed)
    assert 4000 <= len(wave) <= 24_000
    assert len(wave) == 24_000 or np.ptp(wave) == pytest.approx(span), "slowly, where the output is slow, but all of it"
    assert wave.min() >= low - 1e-9 * (abs(low) + span)
    assert wave.max() <= low + span + 1e-9 * (abs(low) + span)
    assert np.abs(np.diff(wave)).max() * RATE_HZ <= 0.51 * slew
    assert 0.5 * (wave.max() + wave.min()) == pytest.approx(low + 0.5 * span, abs=1e-6 * (abs(low) + span))


def test_multisine_is_equation_13():
    """Lines at the five frequencies, in the given proportions, and nothing else."""
    wave = multisine(0.0, 100.0, 1e9, RATE_HZ, 10.0, 3)
    lines = 2.0 * np.abs(np.fft.rfft(wave)) / len(wave)
    hz = np.fft.rfftfreq(len(wave), 1.0 / RATE_HZ)
    found = np.array([lines[np.argmin(np.abs(hz - f))] for f in IDENTIFICATION_HZ])
    assert found / found[0] == pytest.approx(np.array(IDENTIFICATION_SHARE) / IDENTIFICATION_SHARE[0], rel=1e-6)
    others = [k for k, f in enumerate(hz) if k and np.abs(np.array(IDENTIFICATION_HZ) - f).min() > 0.05]
    assert lines[others].max() < 1e-9 * found[0]


@given(
    wave=st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=50),
    rest=st.floats(-100.0, 100.0),
    slew=st.floats(50.0, 1e5),
)
def test_soft_begins_and_ends_at_rest(wave, rest, slew):
    wave = np.array(wave)
    whole = soft(wave, rest, RATE_HZ, slew)
    lead = (len(whole) - len(wave)) // 2
    assert np.array_equal(whole[lead : lead + len(wave)], wave)  # the experiment itself is untouched
    assert whole[0] == whole[-1] == rest
    assert lead >= 0.5 * RATE_HZ
    for way in (whole[: lead + 1], whole[lead + len(wave) - 1 :]):
        steps = np.abs(np.diff(way))
        assert steps.max() * RATE_HZ <= 0.51 * slew
        assert steps[[0, -1]].max() <= 1e-4 * 200.0  # no jerk at its ends


@pytest.mark.parametrize(("low", "high"), [(0.0, 140.0), (-20.0, 150.0), (5.0, 6.0)])
def test_shrinking_triangle(low, high):
    """Figure 2: straight lines, alternately up and down, each loop smaller by the same step, ending in the middle."""
    turns, samples = 6, 500
    wave = shrinking_triangle(low, high, turns, samples)
    assert len(wave) == 2 * turns * samples + 1
    assert wave.min() == low
    assert wave.max() == high
    corners = wave[::samples]
    assert (np.sign(np.diff(corners)) == [1, -1] * turns).all()
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    assert corners[1::2] - centre == pytest.approx(half * (1.0 - np.arange(turns) / turns))
    assert centre - corners[2::2] == pytest.approx(half * (1.0 - np.arange(turns) / turns))
    inner = np.delete(np.arange(1, len(wave) - 1), np.arange(samples - 1, len(wave) - 2, samples))
    assert np.abs(np.diff(wave, 2)[inner - 1]).max() < 1e-9 * half


@given(low=st.floats(-100.0, 100.0), span=st.floats(1.0, 200.0), slew=st.floats(50.0, 1e6), seed=st.integers(0, 1000))
def test_random_turns_keep_range_and_slew(low, span, slew, seed):
    wave = random_turns(low, low + span, slew, RATE_HZ, 4.0, seed)
    assert len(wave) == 4000
    assert wave.min() >= low - 1e-9 * (abs(low) + span)
    assert wave.max() <= low + span + 1e-9 * (abs(low) + span)
    assert np.abs(np.diff(wave)).max() * RATE_HZ <= 0.51 * slew
    assert np.array_equal(wave, random_turns(low, low + span, slew, RATE_HZ, 4.0, seed))
