"""Spectra in physical units: the amplitude of a known sine."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.gateway.spectrum import on_grid, spectrum

RATE_HZ = 10_000.0


@settings(max_examples=20)
@given(st.floats(50.0, 3000.0), st.floats(0.01, 100.0), st.floats(0.0, 6.28), st.floats(-300.0, 300.0))
def test_a_sine_is_read_within_a_hundredth(frequency_Hz, amplitude, phase, mean):
    t = np.arange(2 * RATE_HZ) / RATE_HZ
    found = spectrum(mean + amplitude * np.sin(2 * np.pi * frequency_Hz * t + phase), RATE_HZ)
    assert found.lines[0].frequency_Hz == pytest.approx(frequency_Hz, rel=0.01)
    assert found.lines[0].amplitude == pytest.approx(amplitude, rel=0.01)


def test_too_few_samples_have_none():
    assert spectrum(np.zeros(10), RATE_HZ) is None
    assert on_grid(np.array([1, 2]), np.array([np.nan, np.nan]))[0].size == 0
