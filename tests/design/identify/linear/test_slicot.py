"""SLICOT's subspace identification (ib01ad, ib01bd) as oracle, on records with one input and one output."""

import ctrlsys
import numpy as np
import pytest

from micromanip.design import fit_linear
from micromanip.design.identify.linear.modal import Modes
from micromanip.design.identify.linear.regression import start

from .known import circle, response, sorted_poles, system, transfer

BLOCK_ROWS, ORDER = 25, 5


def record(noise, samples=4000, seed=1):
    A, B, C, D = system(4, 1, 1)
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(samples, 1))
    y = response(A, B, C, D, u)
    return u, y + noise * y.std() * rng.normal(size=y.shape)


def slicot(u, y, order=ORDER):
    """A, B, C, D, singular values and Kalman gain by MOESP for A, C and N4SID for the rest, as ib01bd advises."""
    u, y = np.asfortranarray(u), np.asfortranarray(y)
    _, r, values, _, info = ctrlsys.ib01ad("M", "Q", "N", "O", "N", "N", BLOCK_ROWS, 1, 1, u, y, 0.0, -1.0)
    assert info == 0
    A, C, B, D, _, _, _, K, _, info = ctrlsys.ib01bd("C", "A", "K", BLOCK_ROWS, order, 1, 1, len(u), r, 0.0)
    assert info == 0
    return A, B, C, D, values, K


def test_without_noise_both_are_exact():
    u, y = record(0.0)
    theirs = slicot(u, y)
    ours = fit_linear([(u, y)], 1e-3, ORDER)
    assert sorted_poles(ours.poles) == pytest.approx(sorted_poles(np.linalg.eigvals(theirs[0])), abs=1e-6)
    assert np.argmax(ours.singular_values[:-1] / ours.singular_values[1:]) + 1 == ORDER
    assert np.argmax(theirs[4][:-1] / theirs[4][1:]) + 1 == ORDER


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_with_noise_ours_is_as_near_to_the_truth(noise):
    u, y = record(noise)
    A, B, C, D, _, _ = slicot(u, y)
    ours = fit_linear([(u, y)], 1e-3, ORDER)
    truth = transfer(*system(4, 1, 1), circle())
    errors = [
        np.linalg.norm(transfer(*matrices, circle()) - truth) / np.linalg.norm(truth)
        for matrices in ((A, B, C, D), (ours.state_space().A, ours.state_space().B, ours.state_space().C, D * 0))
    ]
    assert errors[1] <= 1.05 * errors[0]
    assert sorted_poles(ours.poles) == pytest.approx(sorted_poles(np.linalg.eigvals(A)), abs=0.3 * noise)


def free_run_percent(A, B, C, D, u, y):
    """Fit of a model in state space with its initial state and offset fitted, as `LinearFit.errors` has it."""
    values, vectors = np.linalg.eig(A)
    kept = values.imag > -1e-12
    modes = Modes(values[kept].astype(complex), np.linalg.solve(vectors, B)[kept], (C @ vectors)[:, kept], D)
    error = y - start(modes, u, y).run(modes, u)
    return 100.0 * (1.0 - error.std() / y.std())


def test_free_run_on_held_out_data_is_as_good():
    u, y = record(0.1, 6000)
    A, B, C, D, _, _ = slicot(u[:3000], y[:3000])
    ours = fit_linear([(u[:3000], y[:3000])], 1e-3, ORDER)
    theirs = free_run_percent(A, B, C, D, u[3000:] - u[:3000].mean(), y[3000:])
    assert ours.errors(u[3000:], y[3000:])[0][0] >= theirs - 0.02
    assert theirs > 85.0
