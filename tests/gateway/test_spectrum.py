"""Spectra in physical units: the amplitude of a known sine, the density of known noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch

from micromanip.gateway.spectrum import on_grid, spectrum

RATE_HZ = 10_000.0


@settings(max_examples=20)
@given(st.floats(50.0, 3000.0), st.floats(0.01, 100.0), st.floats(0.0, 6.28), st.floats(-300.0, 300.0))
def test_a_sine_is_read_within_a_hundredth(frequency_Hz, amplitude, phase, mean):
    t = np.arange(2 * RATE_HZ) / RATE_HZ
    found = spectrum(mean + amplitude * np.sin(2 * np.pi * frequency_Hz * t + phase), RATE_HZ)
    assert found.lines[0].frequency_Hz == pytest.approx(frequency_Hz, rel=0.01)
    assert found.lines[0].amplitude == pytest.approx(amplitude, rel=0.01)


def test_the_stage_s_resonance_in_noise():
    rng = np.random.default_rng(1)
    t = np.arange(10 * RATE_HZ) / RATE_HZ
    found = spectrum(0.5 * np.sin(2 * np.pi * 66.0 * t) + rng.normal(0.0, 0.1, len(t)), RATE_HZ)
    assert len(found.lines) == 1
    assert found.lines[0].frequency_Hz == pytest.approx(66.0, rel=0.01)
    assert found.lines[0].amplitude == pytest.approx(0.5, rel=0.01)


def test_the_density_of_white_noise_holds_its_variance():
    values = np.random.default_rng(2).normal(0.0, 0.3, 100_000)
    found = spectrum(values, RATE_HZ)
    level = 0.3 / np.sqrt(RATE_HZ / 2)
    assert np.sqrt(np.mean(found.density[2:-2] ** 2)) == pytest.approx(level, rel=0.03)
    assert np.trapezoid(found.density**2, found.frequency_Hz) == pytest.approx(0.09, rel=0.03)
    assert found.lines == []


@pytest.mark.parametrize("count", [64, 100, 1001, 20_000])
def test_the_density_is_scipys(count):
    """Whose Welch takes as long to import as all else of the gateway."""
    values = np.random.default_rng(count).normal(5.0, 1.0, count)
    found = spectrum(values, RATE_HZ)
    frequency, power = welch(values, RATE_HZ, "hann", round(RATE_HZ / found.frequency_Hz[1]))
    assert found.frequency_Hz == pytest.approx(frequency)
    assert found.density == pytest.approx(np.sqrt(power), rel=1e-9)


def test_skipped_cycles_are_drawn_straight():
    cycles = np.array([10, 11, 14, 15])
    filled, missing = on_grid(cycles, np.array([1.0, 2.0, 5.0, np.nan]))
    assert filled.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 5.0]
    assert missing == 0.5


def test_too_few_samples_have_none():
    assert spectrum(np.zeros(10), RATE_HZ) is None
    assert on_grid(np.array([1, 2]), np.array([np.nan, np.nan]))[0].size == 0
