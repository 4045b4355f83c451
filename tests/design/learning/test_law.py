"""The update, in closed form: what it leaves, what it refuses, and when it goes back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.design.learning.law import (
    ALIKE,
    BETTER,
    FIRST,
    UNPLAYED,
    WORSE,
    compared,
    contraction,
    updated,
)  # fmt: skip
from micromanip.design.learning.memory import Learned, Memory
from micromanip.design.learning.part import Part
from micromanip.design.learning.spectrum import Bands
from micromanip.errors import CheckFailed

RATE_HZ, VALUES = 1000.0, 4000
TIME_S = np.arange(VALUES) / RATE_HZ
LINE = np.cos(2 * np.pi * 9.0 * TIME_S)
LIMIT_UM = 5.0


class Scalar:
    """A plant that is a number: modelled as `gain`, wrong by at most `wrong` of it."""

    highest_Hz = 100.0

    def __init__(self, gain=1.0, wrong=0.3):
        self.gain, self.wrong = gain, wrong

    def response(self, hertz):
        return np.full(len(hertz), self.gain, complex)

    def off(self, hertz):
        return np.full(len(hertz), self.wrong)


def empty():
    return Memory("c", "x", "t", RATE_HZ, 1.0, np.zeros(VALUES), Learned.nothing(VALUES))


def part(error, played=None):
    return Part(RATE_HZ, np.zeros(VALUES), error, np.zeros(VALUES) if played is None else played, 0.0)


def noise(seed, size=0.02):
    return size * np.random.default_rng(seed).normal(size=VALUES)


def made(memory, true_gain, seed, repeats=LINE):
    """The part that a plant of `true_gain` makes with what `memory` plays."""
    played = memory.now.correction_um
    return part(repeats - true_gain * played + noise(seed), played)


def size(error):
    return float(2 * np.mean(error * LINE))


@settings(max_examples=8)
@given(st.floats(-0.3, 0.3), st.floats(0.5, 2.0))
def test_what_is_left_follows_the_closed_form(wrong, gain):
    """r = 1, T_D = (1 - d) T: a_(k+1) = W_k mean(1 + d a_j), e_k = 1 - (1 - d) a_k; W = 1/2 once, then 1."""
    way, memory, played = Scalar(gain), empty(), []
    for k in range(5):
        played.append(size(gain * memory.now.correction_um))
        expected = 0.0 if not k else (0.5 if k == 1 else 1.0) * np.mean([1.0 + wrong * a for a in played[:k]])
        assert played[k] == pytest.approx(expected, abs=0.02)
        rest = np.abs(np.array(played) - 1.0 / (1.0 - wrong))
        assert k < 2 or rest[k] < abs(wrong) * rest[:k].max() + 0.02, "the contraction that is claimed"
        memory = updated(memory, made(memory, (1.0 - wrong) * gain, k), way, LIMIT_UM, f"part {k}").memory


DELAY = 5
"""Values by which the stage is late."""


class Late(Scalar):
    def response(self, hertz):
        return self.gain * np.exp(-2j * np.pi * hertz * DELAY / RATE_HZ)


@settings(max_examples=8)
@given(st.floats(-0.3, 0.3), st.floats(0.5, 2.0))
def test_a_disturbance_that_goes_round_falls_as_the_closed_form_says_from_its_first_value_to_its_last(wrong, gain):
    """With r = sum of harmonics and T_D = (1 - d) T, late: e_k = (1 - (1 - d) a_k) r, a_k as above, at the wrap too."""
    turn = 2 * np.pi * np.arange(VALUES) / VALUES
    repeats = sum(np.cos(k * turn + k) for k in (9, 36, 83))
    way, memory = Late(gain), replace(empty(), repeats=True)
    played, before, shares = np.zeros(VALUES), np.zeros(VALUES), []
    for k in range(4):
        moved = (1.0 - wrong) * gain * np.concatenate([before[-DELAY:], played[:-DELAY]])
        error = repeats - moved
        expected = 0.0 if not k else (0.5 if k == 1 else 1.0) * np.mean([1.0 + wrong * a for a in shares[:k]])
        left = 1.0 - (1.0 - wrong) * expected
        assert error == pytest.approx(left * repeats, abs=0.06), k
        shares.append(expected)
        made_of = Part(RATE_HZ, np.zeros(VALUES), error, played, 0.0, before[-200:])
        memory = updated(memory, made_of, way, 2.0 * LIMIT_UM, f"period {k}", own=True).memory
        played = before = memory.now.correction_um  # the period after the one that still plays the old one


def test_contraction_is_the_largest_gain_of_the_error_on_the_set():
    bands = Bands(VALUES, RATE_HZ, 100.0)
    share = np.zeros(bands.count)
    share[2] = 0.9
    assert contraction(Scalar(wrong=0.3), bands, share) == pytest.approx(0.27, rel=1e-3)
    assert contraction(Scalar(wrong=0.3), bands, np.zeros(bands.count)) == 0.0
    beyond = np.zeros(bands.count)
    beyond[-1] = 1.0  # where the low pass lets a fortieth through
    assert contraction(Scalar(wrong=10.0), bands, beyond) < 1.0


def test_an_update_that_need_not_contract_is_not_applied():
    once = updated(empty(), part(LINE + noise(1)), Scalar(wrong=1.31), LIMIT_UM, "half of a part").memory
    assert once.now.contraction == pytest.approx(0.65, abs=0.01)
    with pytest.raises(CheckFailed, match=r"axis x: the update would leave 1\.\d+ of an error .* not below 1"):
        updated(once, part(LINE + noise(2), once.now.correction_um), Scalar(wrong=1.31), LIMIT_UM, "the next")


def test_a_correction_beyond_its_limit_is_not_applied():
    with pytest.raises(CheckFailed, match=r"would be \d\.\d+ um, at most 2 um may be \(--limit\)"):
        updated(empty(), part(11.0 * LINE + noise(1)), Scalar(), 2.0, "p")


def test_noise_alone_teaches_next_to_nothing():
    memory = empty()
    for k in range(5):
        played = memory.now.correction_um
        memory = updated(memory, part(noise(k, 0.5) - played, played), Scalar(), LIMIT_UM, f"part {k}").memory
    assert np.sqrt(np.mean(memory.now.correction_um**2)) < 0.02


def test_a_part_that_is_worse_beyond_doubt_goes_back_to_what_was_played_before():
    memory, way = empty(), Scalar()
    for k in range(3):
        found = updated(memory, made(memory, 1.0, k), way, LIMIT_UM, f"part {k}")
        memory = found.memory
    assert [told["verdict"] for told in memory.story] == [FIRST, BETTER, BETTER]
    turned = updated(memory, made(memory, 1.0, 9, repeats=-LINE), way, LIMIT_UM, "another path error")
    assert (turned.verdict, turned.forgotten) == (WORSE, True)
    assert np.array_equal(turned.memory.now.correction_um, memory.before.correction_um)
    assert turned.memory.now.parts == memory.before.parts
    once_more = updated(turned.memory, made(turned.memory, 1.0, 10, repeats=-5 * LINE), way, LIMIT_UM, "worse still")
    assert once_more.forgotten
    assert not once_more.memory.now.correction_um.any()
    assert once_more.memory.now.parts == 0
    assert once_more.memory.generation == 5


def test_a_part_without_its_correction_counts_and_is_compared_with_none():
    memory, way = empty(), Scalar()
    for k in range(3):
        memory = updated(memory, made(memory, 1.0, k), way, LIMIT_UM, f"part {k}").memory
    found = updated(memory, part(LINE + noise(7)), way, LIMIT_UM, "unplayed")
    assert (found.verdict, found.forgotten) == (UNPLAYED, False)
    assert found.memory.now.parts == 4
    assert np.array_equal(found.memory.blocks_um2, memory.blocks_um2)
    half = 0.5 * memory.now.correction_um
    older = part(LINE - half + noise(8), half)
    with pytest.raises(CheckFailed, match="or of an older state of this one"):
        updated(memory, older, way, LIMIT_UM, "older")
    found = updated(memory, older, way, LIMIT_UM, "older", own=True)
    assert found.verdict == UNPLAYED
    assert found.memory.now.mean_um == pytest.approx(memory.now.mean_um, abs=0.3)


def test_what_is_not_of_this_memory_is_refused():
    memory, way = updated(empty(), part(LINE + noise(1)), Scalar(), LIMIT_UM, "first").memory, Scalar()
    with pytest.raises(CheckFailed, match="again: axis x has learned from this part already"):
        updated(memory, part(LINE + noise(1)), way, LIMIT_UM, "again")
    with pytest.raises(CheckFailed, match=r"a correction of 0\.7.* um rms was played to axis x, .* of another memory"):
        updated(memory, part(noise(2), -LINE), way, LIMIT_UM, "foreign")
    narrow = Scalar()
    narrow.highest_Hz = 1.0
    with pytest.raises(CheckFailed, match="known to 1 Hz, a part of 4 s tells"):
        updated(memory, part(noise(2)), narrow, LIMIT_UM, "coarse")
    narrow.highest_Hz = 0.5 * way.highest_Hz
    memory = updated(memory, part(noise(3)), way, LIMIT_UM, "second").memory
    with pytest.raises(CheckFailed, match="its memory was made up to another frequency than the"):
        updated(memory, part(noise(4)), narrow, LIMIT_UM, "another version")


@given(st.integers(0, 2**32 - 1))
def test_chance_is_no_difference(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.chisquare(40, (2, 16)) / 40
    assert compared(np.zeros(0), one) == FIRST
    assert compared(one, one + 1.0) == WORSE
    assert compared(one + 1.0, one) == BETTER
    assert compared(one, one) == ALIKE
    assert {compared(one, other), compared(other, one)} in ({ALIKE}, {WORSE, BETTER})
