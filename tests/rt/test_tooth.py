"""The tooth's frequency, found from the estimator's own oscillator; and given up where that does not help."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from micromanip.control.outer_gains import outer_gains
from micromanip.control.tooth import followed_tooth, removed, turned
from micromanip.rt.laws.estimator import ESTIMATOR_STATE, GAPS, start_estimator
from micromanip.rt.laws.frequency_lock import AT_END, FOLLOWS, NO_GAIN, tooth_Hz

from .builders import PERIOD_S, record
from .kernels import tooth_course
from .outer_loops import designed, parameters

PERCENT, SAID_HZ = 3.0, 200.0
SETTINGS, GAINS, _ = designed(oscillation_Hz=SAID_HZ, oscillation_um=2e-3, disturbance_um=0.02)
SETTINGS = SETTINGS.model_copy(update={"oscillation_range_percent": PERCENT})
FOUND = followed_tooth(SETTINGS, GAINS, GAPS, PERIOD_S)
N = len(GAINS.A)


def law(settings=SETTINGS, gains=GAINS, **changed):
    found = followed_tooth(settings, gains, GAPS, PERIOD_S)
    names = ("share", "turn", "range", "slew", "floor_um2", "shown", "window", "fade", "patience")
    fields = {f"tooth_{name}": getattr(found, name) for name in names}
    return parameters(gains, tooth=found.place, plain=found.plain, **fields | changed)


def started(p, amplitude_um=0.0):
    s = record(ESTIMATOR_STATE)
    start_estimator(p, s, 0, 0.0, 0.0)
    for state in (s["x"], s["filtered"]):
        state[N - 2] = amplitude_um
    return s


def played(p, s, y, every=1):
    """What the estimator finds along the samples `y`: turns (rad a cycle) and innovations (um)."""
    turns, innovations, states = np.zeros(len(y)), np.zeros(len(y)), np.zeros((len(y), N))
    tooth_course(p, s, np.asarray(y, float), every, turns, innovations, states)
    return turns, innovations, states


def readings(count, hertz, amplitude_um=3.0, gains=GAINS, noise_um=0.0, seed=1, settled=True):
    """The stage of the model, its set-point at rest, pushed by a tooth (um of set-point) at `hertz`."""
    n = gains.controllable
    A, a, c = gains.A[:n, :n], gains.A[:n, -2], gains.C[:n]
    turn = 2.0 * np.pi * hertz * PERIOD_S
    x, y = np.zeros(n), np.zeros(count)
    if settled:  # the answer to a sine that always was
        phasor = np.linalg.solve(np.exp(1j * turn) * np.eye(n) - A, a)
        return amplitude_um * np.real(c @ phasor * np.exp(1j * turn * np.arange(1, count + 1))) + (
            noise_um * np.random.default_rng(seed).normal(size=count)
        )
    for k in range(count):
        x = A @ x + a * amplitude_um * np.cos(turn * k)
        y[k] = c @ x
    return y


@pytest.mark.many_cycles
@pytest.mark.parametrize("off_percent", [-2.0, 0.1, 2.0])
def test_the_frequency_is_found(off_percent):
    hertz = SAID_HZ * (1.0 + 0.01 * off_percent)
    p = law()
    s = started(p)
    turns, innovations, _ = played(p, s, readings(12_000, hertz))
    assert s["given_up"] == FOLLOWS
    assert tooth_Hz(p, s, 1e-9 / PERIOD_S) == pytest.approx(hertz, abs=1e-3)
    assert np.abs(innovations[-500:]).max() < 1e-3 * np.abs(innovations).max()
    assert (np.abs(np.diff(turns)) <= FOUND.slew * (1 + 1e-9)).all()


@pytest.mark.many_cycles
def test_it_is_the_loop_of_its_equation():
    """Near the frequency a small error follows ``z^2 - (2 - b) z + 1 - b + b g`` from where it begins."""
    b, g = removed(GAINS), FOUND.share
    off = 2.0 * np.pi * 0.02 * PERIOD_S
    p = law()
    s = started(p)
    played(p, s, readings(6000, SAID_HZ))  # locked where it was said
    s["turn"] = off
    turns, _, _ = played(p, s, readings(9000, SAID_HZ)[6000:])
    phase, turn, expected = 0.0, off, np.zeros(3000)
    for k in range(3000):
        phase += turn
        turn -= g * b * phase
        phase -= b * phase
        expected[k] = turn
    assert abs(expected[-1]) < 0.05 * off
    assert expected.min() < -0.02 * off, "with a damping of .7 it goes a little beyond"
    assert turns == pytest.approx(expected, abs=0.04 * off)


@pytest.mark.parametrize("share", [-1.0, 0.4])
def test_a_frequency_that_was_found_makes_the_filter_of_that_frequency(share):
    """filterpy's, with the gain as it is and the model that turns by so much more."""
    angle = share * FOUND.range
    kf = KalmanFilter(dim_x=N, dim_z=1)
    kf.F, kf.H, kf.K = turned(GAINS, angle).A, GAINS.C[None, :], GAINS.observer[:, None]
    kf.x = np.zeros((N, 1))
    y = np.random.default_rng(3).normal(size=300)
    p = law(tooth_slew=0.0)
    s = started(p)
    s["turn"] = angle
    _, _, states = played(p, s, y)
    expected = np.zeros_like(states)
    for k in range(300):
        kf.predict_steadystate()
        kf.update_steadystate(y[k : k + 1])
        expected[k] = kf.x[:, 0]
    assert states == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.floats(-1.0, 1.0), st.integers(1, 5))
def test_it_never_leaves_its_range_nor_hurries(y, begun, every):
    p = law(tooth_window=7)
    s = started(p, 1.0)
    s["turn"] = begun * FOUND.range
    before = float(s["turn"])
    turns, _, states = played(p, s, y, every)
    assert (np.abs(turns) <= FOUND.range).all()
    assert (np.abs(np.diff(turns, prepend=before)) <= FOUND.slew * (1 + 1e-9)).all()
    assert np.isfinite(states).all()


@given(st.floats(-1.0, 1.0))
def test_without_samples_it_swings_on_as_it_was(begun):
    p = law()
    s = started(p, 2.0)
    s["turn"] = begun * FOUND.range
    _, _, states = played(p, s, np.zeros(50), every=1000)
    assert np.hypot(states[:, -2], states[:, -1]) == pytest.approx(2.0, rel=1e-9)
    angle = 50 * (FOUND.turn + float(s["turn"]))
    assert states[-1, -2:] == pytest.approx([2.0 * math.cos(angle), -2.0 * math.sin(angle)], abs=1e-9)


def test_without_a_tooth_nothing_is_followed():
    """What noise makes of the oscillator stays below the floor; nothing is given up in twenty windows of it."""
    p = law(tooth_window=200)
    s = started(p)
    noise = np.random.default_rng(5).normal(size=4000) * SETTINGS.sensor_noise_um
    turns, _, _ = played(p, s, noise)
    assert (turns == 0.0).all()
    assert s["given_up"] == FOLLOWS


def settled_without(y):
    """Estimates of the filter that has no oscillator, along the same samples."""
    x, A, C, gain = np.zeros(N - 2), GAINS.A[: N - 2, : N - 2], GAINS.C[: N - 2], FOUND.plain[0, : N - 2]
    for value in y:
        x = A @ x
        x = x + gain * (value - C @ x)
    return x


@pytest.mark.many_cycles
def test_one_that_is_out_of_reach_is_given_up_without_a_bump():
    p = law(tooth_window=2000)
    s = started(p)
    y = readings(16_000, 1.06 * SAID_HZ)
    turns, _, states = played(p, s, y)
    assert s["given_up"] == AT_END
    assert turns[-1] == pytest.approx(FOUND.range)
    patient = law()
    _, _, kept = played(patient, started(patient), y[:9000])
    bends, usual = (np.abs(np.diff(each @ GAINS.feedback, 2))[1000:].max() for each in (states, kept))
    assert np.hypot(*kept[-1, -2:]) > 0.3, "what would be a step"
    assert bends < 1.5 * usual < 0.2
    assert (states[-1, -2:] == 0.0).all()
    assert states[-1, : N - 2] == pytest.approx(settled_without(y), abs=1e-6)


@pytest.mark.parametrize(("patience", "given_up"), [(1, NO_GAIN), (2, FOLLOWS)])
def test_one_that_makes_the_innovation_worse_is_given_up(patience, given_up):
    """The tool has left the cut, and the oscillator swings on: the longer it does, the longer nobody minds."""
    slow = SETTINGS.model_copy(update={"oscillation_um": 5e-4})
    p = law(slow, outer_gains(slow, None, PERIOD_S), tooth_window=1000, tooth_patience=patience)
    s = started(p, 3.0)
    played(p, s, np.zeros(1000))
    assert s["given_up"] == given_up
