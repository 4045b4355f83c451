"""Subspace identification on systems that are known."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from micromanip.design.excitation import band_noise
from micromanip.design.subspace import fit_siso, modal, simulate, stabilised

STEP_S = 1e-4


def mode(hz, damping):
    """Discrete pole of a damped mode at 10 kHz."""
    omega = 2 * np.pi * hz
    return np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * omega * STEP_S)


def known_system(scramble=0):
    """A lightly damped mode near 66 Hz, a faster one, and a lag: in coordinates that tell nothing."""
    A = np.zeros((5, 5))
    for k, pole in enumerate((mode(66.0, 0.012), mode(800.0, 0.05))):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
    A[4, 4] = 0.9
    B, C = np.array([0.3, -0.3, 0.4, 0.2, 0.5]), np.array([0.3, 0.3, -0.2, 0.1, 0.1])
    T = np.random.default_rng(scramble).normal(size=(5, 5)) + 2 * np.eye(5)
    return np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T


def transfer(A, B, C, hz):
    z = np.exp(2j * np.pi * np.asarray(hz) * STEP_S)
    return np.array([C @ np.linalg.solve(point * np.eye(len(A)) - A, B) for point in z])


def sorted_poles(A):
    poles = np.linalg.eigvals(A)
    return poles[np.lexsort((poles.imag, np.round(poles.real, 6)))]


def record(delay, noise, samples=8_000):
    """Input, output behind `delay` samples with white noise of the given share, means taken off."""
    A, B, C = known_system()
    u = band_noise(1.5, 1000.0, 1.0 / STEP_S, samples, seed=4)
    clean = simulate(A, B, C, np.concatenate([np.zeros(delay), u[: len(u) - delay]]))
    y = clean + noise * clean.std() * np.random.default_rng(5).standard_normal(samples)
    return u - u.mean(), y - y.mean()


@pytest.mark.parametrize("delay", [0, 2])
def test_almost_exact_without_noise(delay):
    A, B, C = known_system()
    model = fit_siso(*record(delay, 0.0), order=5, delay=delay)
    assert sorted_poles(model.A) == pytest.approx(sorted_poles(A), abs=2e-3)
    hz = [1.0, 30.0, 66.0, 200.0, 800.0, 2000.0]
    assert transfer(model.A, model.B, model.C, hz) == pytest.approx(transfer(A, B, C, hz), rel=1e-2)
    assert model.fit_percent > 99.0
    assert model.singular_values[4] > 50 * model.singular_values[5]  # the order can be read off


def test_poles_are_recovered_from_noise():
    A, B, C = known_system()
    model = fit_siso(*record(2, 0.01), order=5, delay=2)
    slow = max(np.linalg.eigvals(model.A), key=lambda pole: abs(pole))
    s = np.log(slow) / STEP_S
    assert abs(s) / (2 * np.pi) == pytest.approx(66.0, abs=0.5)
    assert -s.real / abs(s) == pytest.approx(0.012, abs=0.004)
    hz = [10.0, 50.0, 66.0, 100.0, 300.0]
    assert transfer(model.A, model.B, model.C, hz) == pytest.approx(transfer(A, B, C, hz), rel=0.05)
    assert 97.0 < model.fit_percent < 99.9  # the noise itself can't be explained


def test_the_right_delay_fits_best():
    u, y = record(3, 0.001)
    fits = {delay: fit_siso(u, y, order=5, delay=delay).fit_percent for delay in (1, 3, 5)}
    assert max(fits, key=fits.get) == 3


def test_too_low_an_order_shows_on_held_out_data():
    u, y = record(2, 0.0)
    assert fit_siso(u, y, order=2, delay=2).fit_percent < fit_siso(u, y, order=5, delay=2).fit_percent - 1.0


@given(st.integers(0, 1000))
def test_modal_form_is_the_same_system(seed):
    A, B, C = known_system(seed)
    assume(np.linalg.cond(np.linalg.eig(A)[1]) < 1e6)
    a, b, c = modal(A, B, C)
    hz = [0.0, 5.0, 66.0, 300.0, 800.0, 4000.0]
    assert transfer(a, b, c, hz) == pytest.approx(transfer(A, B, C, hz), rel=1e-7)
    assert sorted_poles(a) == pytest.approx(sorted_poles(A), abs=1e-8)
    pairs = np.abs(a) > 1e-9
    assert pairs.sum() <= 2 * 4 + 1  # two pairs and a real pole, nothing beside them


def test_stabilised_reflects_the_unstable_poles_only():
    stable = known_system()[0]
    assert stabilised(stable) is stable  # not even rounded
    poles = np.array([1.02, 0.95, 0.5])
    T = np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.4], [0.2, -0.3, 1.0]])
    A = T @ np.diag(poles) @ np.linalg.inv(T)
    assert np.sort(np.linalg.eigvals(stabilised(A)).real) == pytest.approx([0.5, 0.95, 1 / 1.02])
    # the directions stay: scaling all of A would have moved the good poles
    for k in (1, 2):
        assert stabilised(A) @ T[:, k] == pytest.approx(poles[k] * T[:, k])


@given(hz=st.floats(5.0, 4000.0), growth=st.floats(1e-6, 0.1))
def test_stabilised_keeps_frequency_of_an_unstable_pair(hz, growth):
    pole = (1.0 + growth) * np.exp(2j * np.pi * hz * STEP_S)
    A = np.array([[pole.real, -pole.imag, 0.1], [pole.imag, pole.real, 0.0], [0.0, 0.0, 0.8]])
    new = np.linalg.eigvals(stabilised(A))
    assert np.abs(new).max() < 1.0
    upper = new[np.argmax(new.imag)]
    assert abs(upper) == pytest.approx(1.0 / (1.0 + growth))
    assert np.angle(upper) == pytest.approx(np.angle(pole))
    assert np.abs(new - 0.8).min() < 1e-9
