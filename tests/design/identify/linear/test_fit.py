"""`fit_linear` on systems that are known: exact without noise, and honest with it."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.signal import dlsim

from micromanip.design import fit_linear
from micromanip.design.identify.linear.modal import Modes, decompose
from tests.design.identify.linear.known import circle, response, sorted_poles, system, transfer


def modes_of(A, B, C, D):
    """The known system by modes: inputs by the left eigenvectors."""
    values, vectors = np.linalg.eig(A)
    kept = values.imag > -1e-12
    return Modes(values[kept].astype(complex), np.linalg.solve(vectors, B)[kept], (C @ vectors)[:, kept], D)


@given(st.integers(0, 1000))
def test_same_system(seed):
    A, B, C, D = system(seed)
    D = D + 0.3
    assume(np.linalg.cond(np.linalg.eig(A)[1]) < 1e6)
    modes = modes_of(A, B, C, D)
    assert modes.order == 5
    truth = transfer(A, B, C, D, circle())
    close = 1e-7 * np.abs(truth).max()
    assert modes.frequency_response(circle()) == pytest.approx(truth, abs=close)
    assert transfer(*modes.state_space(), circle()) == pytest.approx(truth, abs=close)
    a, b, c, _ = modes.state_space()
    assert np.count_nonzero(a) <= 2 * 4 + 1  # two pairs and a real pole, nothing beside them
    assert np.linalg.norm(b[:2]) == pytest.approx(np.linalg.norm(c[:, :2]) / 2, rel=1e-6) or modes.weights[0] == 1.0
    u = np.random.default_rng(seed).normal(size=(200, 2))
    expected = dlsim((A, B, C, D, 1.0), u)[1]
    assert modes.simulate(u) == pytest.approx(expected, abs=1e-7 * np.abs(expected).max())


@given(angle=st.floats(0.01, 3.1), growth=st.floats(0.0, 0.1))
def test_a_reflected_pair_keeps_its_frequency(angle, growth):
    pole = (1.0 + growth) * np.exp(1j * angle)
    A = np.array([[pole.real, -pole.imag, 0.1], [pole.imag, pole.real, 0.0], [0.0, 0.0, 0.8]])
    found, _ = decompose(A, np.ones((1, 3)))
    assert np.abs(found).max() < 1.0
    upper = found[np.argmax(found.imag)]
    assert abs(upper) == pytest.approx(1.0 / (1.0 + growth), abs=1e-8)
    assert np.angle(upper) == pytest.approx(angle)
    assert np.abs(found - 0.8).min() < 1e-9


def late(u, delays):
    """Inputs that act so many samples later; before the record they were something else."""
    rng = np.random.default_rng(99)
    return np.column_stack([np.concatenate([rng.normal(size=d), u[: len(u) - d, i]]) for i, d in enumerate(delays)])


def experiments(count=3, samples=700, delays=(0, 0), noise=0.0, model=None):
    """Records of one system from different states, with different offsets of the outputs."""
    A, B, C, D = model or system()
    rng = np.random.default_rng(5)
    found = []
    for _ in range(count):
        u = rng.normal(size=(samples, B.shape[1])) + [3.0, -1.0][: B.shape[1]]
        y = response(A, B, C, D, late(u, delays), x0=5 * rng.normal(size=len(A)))
        y += 10 * rng.normal(size=len(C)) + noise * y.std(axis=0) * rng.normal(size=y.shape)
        found.append((u, y))
    return found


def of_state_space(model, z):
    return transfer(model.A, model.B, model.C, model.D, z)


def test_exact_without_noise():
    """Several inputs, outputs, experiments with states and offsets of their own; the order is found, too."""
    A, B, C, D = system()
    data = experiments()
    model = fit_linear(data, 1e-3)
    assert model.order == 5
    assert model.delays == (0, 0)
    assert sorted_poles(model.poles) == pytest.approx(sorted_poles(np.linalg.eigvals(A)), abs=1e-7)
    truth = transfer(A, B, C, D, circle())
    assert of_state_space(model.state_space(), circle()) == pytest.approx(truth, abs=1e-6 * np.abs(truth).max())
    assert model.singular_values[4] > 1e6 * model.singular_values[5]
    for u, y in experiments(count=5)[3:]:  # the last ones were not fitted to
        assert model.simulate(u, y) == pytest.approx(y, abs=1e-5 * y.std())
        assert model.errors(u, y)[0] == pytest.approx(100.0, abs=1e-3)


@pytest.mark.parametrize("delays", [(0, 3), (4, 1), (2, 2), (0, 30)])
def test_delays_are_found(delays):
    A, B, C, D = system()
    model = fit_linear(experiments(delays=delays), 1e-3)
    assert (model.order, model.delays) == (5, delays)
    z = circle()
    truth = transfer(A, B, C, D, z) * z[:, None, None] ** -np.array(delays)
    whole = model.state_space()
    assert whole.nstates == 5 + sum(delays)
    assert of_state_space(whole, z) == pytest.approx(truth, abs=1e-6 * np.abs(truth).max())
    u, y = experiments(count=4, delays=delays)[3]
    assert model.simulate(u, y) == pytest.approx(y, abs=1e-5 * y.std())


def test_direct_term_is_found():
    A, B, C, _ = system(outputs=2)
    D = np.array([[0.5, 0.0], [0.0, -2.0]])
    model = fit_linear(experiments(model=(A, B, C, D)), 1e-3)
    assert model.order == 5
    assert model.state_space().D == pytest.approx(D, abs=1e-6)
    strict = fit_linear(experiments(), 1e-3)
    assert (strict.state_space().D == 0.0).all()


def test_noise_costs_what_it_must():
    """The free run misses the noise and little more; poles and response are close."""
    A, B, C, D = system()
    model = fit_linear(experiments(2, 4000, noise=0.05), 1e-3)
    assert model.order == 5
    assert sorted_poles(model.poles) == pytest.approx(sorted_poles(np.linalg.eigvals(A)), abs=5e-3)
    truth = transfer(A, B, C, D, circle())
    assert of_state_space(model.state_space(), circle()) == pytest.approx(truth, abs=0.02 * np.abs(truth).max())
    u, y = experiments(3, 4000, noise=0.05)[2]
    assert model.errors(u, y)[1] == pytest.approx(100 * 0.05 / np.sqrt(1 + 0.05**2), rel=0.05)
    moved = y + np.array([5.0, -7.0, 1.0])
    assert model.errors(u, moved)[1] == pytest.approx(model.errors(u, y)[1])


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_units_do_not_matter(seed, size_u, size_y):
    """The same record in other units gives the same poles and the same fit."""
    A, B, C, D = system(seed, 1, 2)
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(600, 1))
    y = response(A, B, C, D, u, x0=rng.normal(size=5))
    y += 0.01 * y.std(axis=0) * rng.normal(size=y.shape)
    one, other = fit_linear([(u, y)], 1e-3, 5), fit_linear([(size_u * u, size_y * y)], 1e-3, 5)
    assert sorted_poles(other.poles) == pytest.approx(sorted_poles(one.poles), abs=1e-5)
    assert other.errors(size_u * u, size_y * y)[0] == pytest.approx(one.errors(u, y)[0], abs=1e-3)
    z = circle()
    truth = of_state_space(one.state_space(), z) * size_y / size_u
    assert of_state_space(other.state_space(), z) == pytest.approx(truth, abs=1e-4 * np.abs(truth).max())


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda u, y: (u[:30], y[:30]), "an experiment of 30 samples is too short; at least 60 are needed"),
        (lambda u, y: (u * [0.0, 1.0], y), "input 1 is constant or not finite"),
        (lambda u, y: (u, y * [1.0, 1.0, np.nan]), "output 3 is constant or not finite"),
    ],
)
def test_what_can_not_be_fitted_is_said(spoil, sentence):
    with pytest.raises(ValueError, match=sentence):
        fit_linear([spoil(*experiments(1)[0])], 1e-3)


def test_an_input_without_effect_and_an_output_of_noise():
    """Nothing is made up: the gain of the idle input is small, and noise is not explained."""
    A, B, C, D = system(3, 1, 1)
    rng = np.random.default_rng(1)
    u, idle = rng.normal(size=(4000, 1)), rng.normal(size=(4000, 1))
    y = response(A, B, C, D, u)
    y += 0.1 * y.std() * rng.normal(size=y.shape)
    model = fit_linear([(np.hstack([u, idle]), np.hstack([y, rng.normal(size=y.shape)]))], 1e-3)
    size = np.linalg.norm(of_state_space(model.state_space(), circle()), axis=0)
    assert size[0, 1] < 0.03 * size[0, 0]
    assert model.errors(np.hstack([u, idle]), np.hstack([y, rng.normal(size=y.shape)]))[0][1] < 2.0
