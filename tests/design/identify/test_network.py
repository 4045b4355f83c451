"""Recurrent network: exact gradients, a free run that the loop repeats, and errors beside the tanh model."""

import numpy as np
import pytest
from rt.builders import record
from rt.kernels import network_course

from micromanip.design.excitation import random_turns
from micromanip.design.identify.network.fit import fit_network, reversals, smoothed
from micromanip.design.identify.network.training import Course, gradient
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS, HYSTERESIS_STATE
from micromanip.rt.laws.network import start_network
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii

from ..actuators import predict

pytestmark = pytest.mark.long
RATE_HZ = 500.0
ACTUATOR = PrandtlIshlinskii(
    model="pi",
    shaping="tanh",
    coefficients=(90.0, 0.009, -0.6, 55.0),
    thresholds_um=(3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 21.0, 24.0),
    weights=(0.09, 0.08, 0.07, 0.06, 0.05, 0.04, 0.03, 0.02),
    range_um=(-1e4, 1e4),
)


def voltage(seed, seconds=30.0):
    return random_turns(0.0, 130.0, 1e6, RATE_HZ, seconds, seed)


def displacement(v, noise_um=0.05, seed=1):
    return predict(ACTUATOR, v, 1.0 / RATE_HZ) + noise_um * np.random.default_rng(seed).standard_normal(len(v))


@pytest.fixture(scope="module")
def inverse():
    """An inverse network of a known actuator, from a noisy record."""
    v = voltage(1, 20.0)
    return fit_network(smoothed(displacement(v)), v, starts=1, burn_in=500)


@pytest.mark.parametrize("segment", [0, 1, 4])
def test_gradient_is_that_of_the_free_run(segment):
    """Central differences of the cost, with the memory restarted now and then, and never."""
    rng = np.random.default_rng(2)
    u, y = rng.standard_normal(60), rng.standard_normal(60)
    course = Course(u, y, reversals(u, 0.3), np.where(np.arange(60) < 5, 0.0, 1.0), step=0.7, slope=0.9, width=0.4)
    assert course.moves.sum() > 10
    theta = 0.3 * rng.standard_normal(5 * 3 + 1)
    restarts = course.restarts(segment)
    _, A, g = gradient(theta, course, restarts)
    h, expected = 1e-6, np.empty_like(theta)
    for i, unit in enumerate(np.eye(len(theta))):
        up, down = (gradient(theta + sign * h * unit, course, restarts)[0] for sign in (1.0, -1.0))
        expected[i] = (up - down) / (4.0 * h)
    np.testing.assert_allclose(g, expected, rtol=1e-5, atol=1e-6)
    assert (A == A.T).all()
    assert np.linalg.eigvalsh(A).min() > -1e-9


def test_the_loop_repeats_the_free_run(inverse):
    """What is exported is what was judged: sample by sample, turning points and all."""
    y = displacement(voltage(3, 6.0), 0.0)
    p, s, out = record(HYSTERESIS_PARAMETERS), record(HYSTERESIS_STATE), np.empty(len(y))
    fill_hysteresis(p, inverse.to_settings((0.0, 130.0)), 1e-4)
    start_network(s, y[0], 40.0)
    network_course(p, s, y, out)
    assert reversals(y, inverse.reversal).sum() > 10
    np.testing.assert_allclose(out, inverse.predict(y, 40.0), atol=1e-6)


def test_the_inverse_predicts_what_it_was_not_trained_on(inverse):
    v = voltage(5)
    error = (inverse.predict(displacement(v, 0.0)) - v)[500:]
    hysteresis = v - np.polyval(np.polyfit(displacement(v, 0.0), v, 3), displacement(v, 0.0))
    assert np.std(error) < 0.25 * np.std(hysteresis)


def test_what_cannot_be_trained():
    with pytest.raises(ValueError, match="equally long"):
        fit_network(np.zeros(100), np.zeros(99))
