"""Kalman filter and smoother over a recording: against the whole Gaussian posterior, computed densely."""

import control
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from micromanip.design.smoothing import smooth

A = np.array([[0.9, 0.2], [-0.2, 0.8]])
B, C, D = np.array([[1.0], [0.5]]), np.array([[1.0, 0.3]]), np.array([[0.2]])
Q, R, P0 = np.array([[0.05, 0.01], [0.01, 0.02]]), np.array([[0.1]]), np.diag([2.0, 3.0])
MODEL = control.ss(A, B, C, D, 1.0)


def course(count, seed=0):
    """Input, state and output of the model with its noise."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.normal(size=(count, 1)), np.zeros((count, 2)), np.zeros((count, 1))
    x[0] = rng.multivariate_normal(np.zeros(2), P0)
    for k in range(count):
        y[k] = C @ x[k] + D @ u[k] + rng.normal(0, np.sqrt(R[0, 0]))
        if k + 1 < count:
            x[k + 1] = A @ x[k] + B @ u[k] + rng.multivariate_normal(np.zeros(2), Q)
    return u, x, y


def posterior(u, y, upto=None):
    """Mean and covariance of all states at once, given the first `upto` samples: dense least squares."""
    count = len(u)
    rows, target = [np.linalg.cholesky(np.linalg.inv(P0)).T @ np.eye(2, 2 * count)], [np.zeros(2)]
    whiten = np.linalg.cholesky(np.linalg.inv(Q)).T
    for k in range(count - 1):
        row = np.zeros((2, 2 * count))
        row[:, 2 * k : 2 * k + 2], row[:, 2 * k + 2 : 2 * k + 4] = -A, np.eye(2)
        rows.append(whiten @ row)
        target.append(whiten @ (B @ u[k]))
    for k in range(count if upto is None else upto):
        row = np.zeros((1, 2 * count))
        row[:, 2 * k : 2 * k + 2] = C
        if np.isfinite(y[k]).all():
            rows.append(row / np.sqrt(R))
            target.append((y[k] - D @ u[k]) / np.sqrt(R[0]))
    J, b = np.vstack(rows), np.concatenate(target)
    covariance = np.linalg.inv(J.T @ J)
    return (covariance @ J.T @ b).reshape(count, 2), covariance


@pytest.mark.parametrize("missing", [[], [3, 4, 11]])
def test_smoother_is_the_posterior_of_the_whole_record(missing):
    u, _, y = course(25)
    y[missing] = np.nan
    found = smooth(MODEL, u, y, process_noise=Q, sensor_noise=R, initial_covariance=P0)
    mean, covariance = posterior(u, y)
    assert found.smoothed == pytest.approx(mean, abs=1e-9)
    blocks = [covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(25)]
    assert found.covariance == pytest.approx(np.array(blocks), abs=1e-9)
    assert found.output == pytest.approx(mean @ C.T + u @ D.T, abs=1e-9)


def test_filter_is_the_posterior_of_the_past():
    u, _, y = course(12)
    found = smooth(MODEL, u, y, process_noise=Q, sensor_noise=R, initial_covariance=P0)
    for k in range(12):
        mean, covariance = posterior(u, y, upto=k + 1)
        assert found.filtered[k] == pytest.approx(mean[k], abs=1e-9)
        assert found.filtered_covariance[k] == pytest.approx(covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], abs=1e-9)


def test_smoothing_beats_filtering_and_says_by_how_much():
    u, x, y = course(3000)
    found = smooth(MODEL, u, y, process_noise=Q, sensor_noise=R)
    errors = [np.mean((states - x)[50:-50] ** 2, axis=0) for states in (found.filtered, found.smoothed)]
    assert (errors[1] < 0.95 * errors[0]).all()
    said = [np.diagonal(P[1500]) for P in (found.filtered_covariance, found.covariance)]
    assert errors[0] == pytest.approx(said[0], rel=0.15)
    assert errors[1] == pytest.approx(said[1], rel=0.15)


def test_unknown_start_is_found():
    u, x, y = course(200)
    away = y + (C @ np.array([np.linalg.matrix_power(A, k) @ [30.0, -20.0] for k in range(200)]).T).T
    found = smooth(MODEL, u, away, process_noise=Q, sensor_noise=R)
    assert found.smoothed[0] == pytest.approx(x[0] + [30.0, -20.0], abs=1.5)


def test_continuous_noise_is_discretised():
    """A driven, damped oscillator: the discrete covariance is the integral of the noise carried to the sample."""
    F, G, dt = np.array([[0.0, 1.0], [-4.0, -0.4]]), np.array([[0.0], [1.0]]), 0.3
    density = np.diag([0.0, 0.7])
    noise = quad_vec(lambda s: expm(F * s) @ density @ expm(F * s).T, 0.0, dt)[0]
    held = quad_vec(lambda s: expm(F * s) @ G, 0.0, dt)[0]
    u, _, y = course(40)
    slow = control.ss(F, G, [[1.0, 0.0]], [[0.0]])
    sampled = control.ss(expm(F * dt), held, [[1.0, 0.0]], [[0.0]], dt)
    of_slow = smooth(slow, u, y, process_noise=density, sensor_noise=R, dt=dt, initial_covariance=P0)
    of_sampled = smooth(sampled, u, y, process_noise=noise, sensor_noise=R, initial_covariance=P0)
    assert of_slow.smoothed == pytest.approx(of_sampled.smoothed, abs=1e-9)
    assert of_slow.covariance == pytest.approx(of_sampled.covariance, abs=1e-9)
    with pytest.raises(ValueError, match="continuous"):
        smooth(slow, u, y, process_noise=density, sensor_noise=R)


@pytest.mark.parametrize("wrong", [np.eye(3), -np.eye(2), np.array([[1.0, 0.5], [0.0, 1.0]])])
def test_what_is_no_covariance_is_refused(wrong):
    u, _, y = course(10)
    with pytest.raises(ValueError, match="process noise must be a covariance of 2 states"):
        smooth(MODEL, u, y, process_noise=wrong, sensor_noise=R)


def test_states_that_are_known_exactly_stay_so():
    """A delay of two samples in front: its states have no noise, and no covariance to be inverted."""
    late_A = np.zeros((4, 4))
    late_A[:2, :2], late_A[:2, 2], late_A[2, 3] = A, B[:, 0], 1.0
    late = control.ss(late_A, np.eye(4)[:, 3:], np.hstack([C, np.zeros((1, 2))]), [[0.0]], 1.0)
    noise, start = np.zeros((4, 4)), np.zeros((4, 4))
    noise[:2, :2], start[:2, :2] = Q, P0
    u, _, y = course(60)
    found = smooth(late, u, y, process_noise=noise, sensor_noise=R, initial_covariance=start)
    assert found.smoothed[:, 3] == pytest.approx(np.concatenate([[0.0], u[:-1, 0]]), abs=1e-9)
    assert found.smoothed[:, 2] == pytest.approx(np.concatenate([[0.0, 0.0], u[:-2, 0]]), abs=1e-9)
    plain = control.ss(A, B, C, [[0.0]], 1.0)
    shifted = np.concatenate([[[0.0], [0.0]], u[:-2]])
    expected = smooth(plain, shifted, y, process_noise=Q, sensor_noise=R, initial_covariance=P0)
    assert found.smoothed[:, :2] == pytest.approx(expected.smoothed, abs=1e-8)
