"""A clipped output is told of, and nothing else that is flat at its top: slow peaks, coarse converters, steps."""

import numpy as np
import pytest
from scipy.signal import lfilter

from micromanip.design.identify.linear.experiments import clipped, wrapped

COUNT = 4000
PHASE = 2 * np.pi * 10 * np.arange(COUNT) / COUNT


def ringing(u):
    return lfilter([0.0, 0.0, 0.0, 0.01], [1.0, -1.98, 0.985], u)


@pytest.fixture
def noise():
    return np.random.default_rng(1).standard_normal(COUNT)


def found(u, y):
    return clipped(u[:, None], y)


@pytest.mark.parametrize("behind", [0.0, 3e-4], ids=["in the converter", "before its noise"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_clipped_output_is_told_of(noise, sign, behind):
    u = np.sin(PHASE) + 0.5 * np.sin(3.3 * PHASE)
    y = sign * ringing(u)
    y = np.minimum(y, np.quantile(y, 0.9))
    assert found(u, y + behind * np.ptp(y) * noise).startswith("sticks at its top value ")
    assert found(u, -y + behind * np.ptp(y) * noise).startswith("sticks at its bottom value ")


@pytest.mark.parametrize("codes", [0, 256])
def test_a_counter_that_wraps_is_told_of_and_a_binary_answer_is_not(noise, codes):
    u = np.cumsum(noise)
    y = np.mod(0.3 * u, 8.0)
    y = np.round(y * codes / 8.0) % codes if codes else y
    assert wrapped(u[:, None], y).endswith("times over its whole range")
    assert wrapped(u[:, None], 0.3 * u) is None
    binary = np.sign(noise)
    assert wrapped(binary[:, None], np.concatenate([[0.0], binary[:-1]])) is None
    assert wrapped(binary[:, None], lfilter([0.0, 0.9], [1.0, -0.1], binary)) is None
    assert wrapped(noise[:, None], noise) is None


@pytest.mark.parametrize("codes", [0, 3, 50, 1000])
@pytest.mark.parametrize("lag", [0.0, 0.5, 1.0, 1.5])
def test_slow_peaks_are_not_clipped(lag, codes):
    """Whatever the phase, and however coarse the converter."""
    y = np.sin(PHASE - np.pi * lag)
    assert found(np.sin(PHASE), np.round(codes * y) if codes else y) is None


@pytest.mark.parametrize("gain", [1.0, -1.0])
def test_what_settles_behind_steps_is_not_clipped(noise, gain):
    u = np.sign(np.sin(PHASE))
    y = gain * lfilter([0.1], [1.0, -0.9], np.roll(u, 30))
    assert found(u, y) is None
    assert found(u + 0.01 * noise, y) is None
