"""A sine's swing of the stage: that of a mode without damping to the number, a real one's never more."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

from micromanip.design.stage_swing import StageSwing

MODE_HZ, AT_REST = 100.0, 5.0
OFTEN_HZ = np.arange(1.0, 400.0)


def answer(hertz, damping):
    r = np.asarray(hertz) / MODE_HZ
    return AT_REST / (1.0 - r**2 + 2j * damping * r + 1e-12j)


def swing_um(frequency_hz, amplitude_um, damping):
    """Of the stage's equation, from the sine's beginning on."""
    omega = 2 * np.pi * MODE_HZ
    step_s = 2e-5
    time_s = np.arange(0.0, 3.0, step_s)
    system = ([AT_REST * omega**2], [1.0, 2 * damping * omega, omega**2])
    (ahead,), back, _ = cont2discrete(system, step_s, "foh")
    return np.abs(lfilter(ahead, back, amplitude_um * np.sin(2 * np.pi * frequency_hz * time_s))).max()


def bears(um, frequency_hz, amplitude_um, damping):
    swing = StageSwing(OFTEN_HZ, answer(OFTEN_HZ, damping), 30.0, (30.0 - um, 30.0 + um))
    return swing.refusal(frequency_hz, amplitude_um) is None


@pytest.mark.parametrize("frequency_hz", [5.0, 37.0, 83.0, 130.0, 210.0])
def test_of_a_mode_without_damping_it_is_exact(frequency_hz):
    um = swing_um(frequency_hz, 10.0, 0.0)
    assert bears(1.02 * um, frequency_hz, 10.0, 0.0)
    assert not bears(0.97 * um, frequency_hz, 10.0, 0.0)


@given(st.integers(2, 300), st.floats(0.005, 0.3), st.floats(1.0, 30.0))
def test_a_real_mode_stays_within(frequency_hz, damping, amplitude_um):
    assert not bears(0.98 * swing_um(frequency_hz, amplitude_um, damping), frequency_hz, amplitude_um, damping)


def test_it_says_how_far_and_what_is_seen():
    swing = StageSwing(OFTEN_HZ, answer(OFTEN_HZ, 0.02), -31.6, (-300.0, 300.0))
    assert swing.refusal(1.0, 30.0) is None
    assert swing.refusal(MODE_HZ, 10.0) == (
        "the stage would swing by up to 2500 um about -32 um, and its sensor sees -300 to 300 um"
    )
