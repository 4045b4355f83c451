"""The update, in closed form: what it leaves, what it refuses, and when it begins anew."""

from functools import partial

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from micromanip.design.learning.law import ALIKE, BETTER, FIRST, WORSE, compared, contraction, updated
from micromanip.design.learning.memory import Memory
from micromanip.design.learning.part import ORDER, Bands, Part, answered, filtered, low_pass
from micromanip.errors import CheckFailed

RATE_HZ, VALUES = 1000.0, 4000
TIME_S = np.arange(VALUES) / RATE_HZ
LINE = np.cos(2 * np.pi * 9.0 * TIME_S)
LIMIT_UM = 5.0
RNG = np.random.default_rng(5)


class Scalar:
    """A plant that is a number: modelled as `gain`, wrong by at most `wrong` of it."""

    def __init__(self, gain=1.0, wrong=0.3, highest_Hz=100.0):
        self.gain, self.wrong, self.highest_Hz = gain, wrong, highest_Hz

    def response(self, hertz):
        return np.full(len(hertz), self.gain, complex)

    def off(self, hertz):
        return np.full(len(hertz), self.wrong)


def empty():
    return Memory("c", "x", "t", RATE_HZ, *(np.zeros(VALUES) for _ in range(3)))


def part(error, played=None):
    return Part(RATE_HZ, np.zeros(VALUES), error, np.zeros(VALUES) if played is None else played)


def noise(seed, size=0.02):
    return size * np.random.default_rng(seed).normal(size=VALUES)


def made(memory, true_gain, seed, repeats=LINE):
    """The part that a plant of `true_gain` makes with what `memory` plays."""
    played = memory.correction_um
    return part(repeats - true_gain * played + noise(seed), played)


def after(parts, repeats=LINE):
    """The update with the last of so many parts."""
    memory = empty()
    for k in range(parts):
        update = updated(memory, made(memory, 1.0, k, repeats), Scalar(), LIMIT_UM)
        memory = update.memory
    return update


@settings(max_examples=8)
@given(st.floats(-0.3, 0.3), st.floats(0.5, 2.0))
def test_what_is_left_follows_the_closed_form(wrong, gain):
    """r = 1, T_D = (1 - d) T: a_k = mean(1 + d a_j) from the third part on, e_k = 1 - (1 - d) a_k."""
    way, memory, played = Scalar(gain), empty(), []
    for k in range(5):
        played.append(float(2 * np.mean(gain * memory.correction_um * LINE)))
        expected = 0.0 if k < 2 else np.mean([1.0 + wrong * a for a in played[:k]])
        assert played[k] == pytest.approx(expected, abs=0.02)
        rest = np.abs(np.array(played) - 1.0 / (1.0 - wrong))
        assert k < 2 or rest[k] < abs(wrong) * rest[:k].max() + 0.02, "the contraction that is claimed"
        memory = updated(memory, made(memory, (1.0 - wrong) * gain, k), way, LIMIT_UM).memory


def test_contraction_is_the_largest_gain_of_the_error_on_the_set():
    bands = Bands(VALUES, RATE_HZ, 100.0)
    share = np.zeros(bands.count)
    share[2] = 0.9
    assert contraction(Scalar(wrong=0.3), bands, share) == pytest.approx(0.27, rel=1e-3)
    assert contraction(Scalar(wrong=0.3), bands, np.zeros(bands.count)) == 0.0


def test_an_update_that_need_not_contract_is_not_applied():
    once = updated(empty(), part(LINE + noise(1)), Scalar(wrong=1.31), LIMIT_UM).memory
    with pytest.raises(CheckFailed, match=r"the update would leave 1\.\d+ of an error .* not below 1"):
        updated(once, part(LINE + noise(2)), Scalar(wrong=1.31), LIMIT_UM)


def test_a_correction_beyond_its_limit_is_not_applied():
    once = updated(empty(), part(3.0 * LINE + noise(1)), Scalar(), 2.0).memory
    with pytest.raises(CheckFailed, match=r"would be [23]\.\d+ um, learning.limit_um is 2: not applied"):
        updated(once, part(3.0 * LINE + noise(2)), Scalar(), 2.0)


def test_a_part_that_is_worse_beyond_doubt_ends_what_was_learned():
    third = after(3)
    assert third.verdict == BETTER
    assert (third.error_um, third.without_um) == pytest.approx((0.02, np.sqrt(0.5)), abs=0.02)
    turned = updated(third.memory, made(third.memory, 1.0, 9, repeats=-LINE), Scalar(), LIMIT_UM)
    assert turned.verdict == WORSE
    assert not turned.memory.correction_um.any()
    assert (turned.memory.parts, turned.memory.generation) == (0, 4)
    anew = updated(turned.memory, made(turned.memory, 1.0, 10, repeats=-LINE), Scalar(), LIMIT_UM)
    assert (anew.verdict, anew.memory.parts) == (FIRST, 1)


@given(st.integers(0, 2**32 - 1))
def test_chance_is_no_difference(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.chisquare(40, (2, 16)) / 40
    assert compared(np.zeros(0), one) == FIRST
    assert compared(one, one + 1.0) == WORSE
    assert compared(one + 1.0, one) == BETTER
    assert compared(one, one) == ALIKE
    assert {compared(one, other), compared(other, one)} in ({ALIKE}, {WORSE, BETTER})


def test_the_low_pass_is_a_butterworth_filter_run_forwards_and_backwards():
    x, corner_hz = RNG.normal(size=6000), 25.0
    half = signal.butter(ORDER // 2, corner_hz, fs=RATE_HZ, output="sos")
    expected = signal.sosfiltfilt(half, x)
    found = filtered(x, RATE_HZ, partial(low_pass, corner_hz=corner_hz))
    assert found[500:-500] == pytest.approx(expected[500:-500], abs=0.01 * expected.std())


def test_the_inverse_of_what_has_no_stable_inverse_undoes_it():
    """A resonance at 60 Hz behind two samples, with a zero outside of the unit circle."""
    poles = np.exp(2 * np.pi * 60.0 / RATE_HZ * np.array([-0.1 + 1j, -0.1 - 1j]))
    numerator = np.array([1.0, -1.6])
    numerator *= np.poly(poles).sum() / numerator.sum()
    system = control.tf(np.append(np.zeros(2), numerator), np.append(np.poly(poles).real, [0.0]), 1.0 / RATE_HZ)

    def way(hertz):
        return np.atleast_1d(np.squeeze(system(np.exp(2j * np.pi * hertz / RATE_HZ))))

    x = RNG.normal(size=3000)
    _, expected = control.forced_response(system, np.arange(len(x)) / RATE_HZ, x)
    assert answered(x, RATE_HZ, way) == pytest.approx(expected, abs=1e-4 * expected.std())
    t = np.arange(8000) / RATE_HZ
    wanted = np.exp(-(((t - 4.0) / 1.0) ** 4)) * np.sin(2 * np.pi * 8.0 * t)
    given = filtered(wanted, RATE_HZ, lambda hertz: low_pass(hertz, 50.0) / way(hertz))
    assert np.abs(given - wanted).max() > 0.05, "it is not its own inverse"
    assert answered(given, RATE_HZ, way) == pytest.approx(wanted, abs=1e-3)
