"""Bands of the spectrum: powers as those of the signal, and a confidence that chance does not raise."""

import numpy as np
import pytest
from scipy.signal import welch

from micromanip.design.learning.part import Bands

RATE_HZ, VALUES = 1000.0, 8000
BANDS = Bands(VALUES, RATE_HZ, 75.0)
TIME_S = np.arange(VALUES) / RATE_HZ


def drawn(seed, parts):
    return np.random.default_rng(seed).normal(size=(parts, VALUES))


def judged(errors):
    """Confidence (bands,) by the mean and the spread of `errors` (parts, n)."""
    mean = errors.mean(axis=0)
    spread = np.sum([BANDS.power(each - mean) for each in errors], axis=0) / max(1, len(errors) - 1)
    return BANDS.confidence(BANDS.power(mean), spread, len(errors))


def test_the_power_in_the_bands_is_that_of_the_signal():
    noise = drawn(1, 1)[0]
    hertz, density = welch(noise, RATE_HZ, nperseg=1000)
    inside = (hertz > 0) & (hertz < BANDS.count * BANDS.width_hz)
    assert BANDS.power(noise).sum() == pytest.approx(density[inside].sum() * hertz[1], rel=0.1)
    sine = BANDS.power(0.3 * np.sin(2 * np.pi * 7.6 * TIME_S))
    assert sine.sum() == pytest.approx(0.5 * 0.3**2, rel=0.01)
    assert np.argmax(sine) == int(7.6 / BANDS.width_hz)


@pytest.mark.parametrize("parts", [2, 4])
def test_noise_is_hardly_ever_taken_for_what_repeats(parts):
    taken = [np.count_nonzero(judged(drawn(100 * parts + seed, parts))) for seed in range(20)]
    assert sum(taken) < 0.005 * 20 * BANDS.count


def test_a_line_that_repeats_is_taken_whole_once_there_are_two_parts_and_not_before():
    line = 0.2 * np.sin(2 * np.pi * 12.5 * TIME_S)
    assert not judged(0.2 * drawn(7, 1) + line).any()
    for parts in (2, 5):
        assert 0.97 < judged(0.2 * drawn(7, parts) + line)[12] <= 1.0, parts


def test_a_line_whose_phase_does_not_repeat_is_not_believed():
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, 6)
    errors = [0.2 * np.sin(2 * np.pi * 12.5 * TIME_S + phase) for phase in phases] + 0.02 * drawn(8, 6)
    assert judged(errors)[12] < 0.5
