"""The modal form is the same system; poles outside the unit circle are reflected alone."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.signal import dlsim

from micromanip.design.identify.linear.modal import Modes, decompose

from .known import circle, system, transfer


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
