"""Measured frequency response and coherence, against closed forms."""

import numpy as np
import pytest

from micromanip.design.linear.frequency import frequency_response

from .known import response, system, transfer

DT = 1e-3


def record(samples, noise, seed=0):
    A, B, C, D = system(inputs=2, outputs=2)
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(samples, 2)) @ np.array([[1.0, 0.6], [0.0, 0.8]])  # inputs that are correlated
    y = response(A, B, C, D, u)
    return u, y + noise * y.std(axis=0) * rng.normal(size=y.shape)


def test_without_noise_it_is_the_transfer_matrix():
    measured = frequency_response([record(60_000, 0.0)], DT)
    truth = transfer(*system(inputs=2, outputs=2), np.exp(2j * np.pi * measured.frequency_Hz * DT))
    assert np.linalg.norm(measured.response - truth) < 0.01 * np.linalg.norm(truth)
    assert measured.coherence.min() > 0.99
    assert measured.frequency_Hz[0] == pytest.approx(measured.frequency_Hz[1] - measured.frequency_Hz[0])
    assert measured.frequency_Hz[-1] == pytest.approx(0.5 / DT)


@pytest.mark.parametrize("noise", [0.1, 1.0, 5.0])
def test_coherence_is_the_share_that_the_inputs_explain(noise):
    """One input, white noise on the output: ``1 / (1 + S_nn / (|H|^2 S_uu))`` at each frequency."""
    A, B, C, D = (np.array([[value]]) for value in (0.8, 1.0, 2.0, 0.0))  # no resonance that would leak
    rng = np.random.default_rng(3)
    u = rng.normal(size=(120_000, 1))
    y = response(A, B, C, D, u)
    size = noise * y.std()
    measured = frequency_response([(u, y + size * rng.normal(size=y.shape))], DT, segment=512)
    power = np.abs(transfer(A, B, C, D, np.exp(2j * np.pi * measured.frequency_Hz * DT))[:, 0, 0]) ** 2
    expected = power / (power + size**2)
    assert measured.averages > 400
    assert measured.coherence[:, 0] == pytest.approx(expected, abs=0.12)
    assert np.mean(measured.coherence[:, 0] - expected) == pytest.approx(0.0, abs=0.01)


def test_experiments_are_averaged():
    parts = [record(5_000, 0.5, seed) for seed in range(4)]
    alone, together = frequency_response(parts[:1], DT, 256), frequency_response(parts, DT, 256)
    assert together.averages == 4 * alone.averages
    truth = transfer(*system(inputs=2, outputs=2), np.exp(2j * np.pi * alone.frequency_Hz * DT))
    errors = [np.sqrt(np.mean(np.abs(each.response - truth) ** 2)) for each in (alone, together)]
    assert errors[1] < 0.7 * errors[0]
