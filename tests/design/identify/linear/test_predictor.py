"""A plant within a loop as it is, unstable or not: its poles and noise, and how far ahead it is foretold."""

import numpy as np
import pytest

from micromanip.design.identify.linear.predictor import fit_unstable, foretold_errors, horizon

STEP_S, NOISE = 0.01, 1e-3


def looped(stiffness, seed=1, samples=3000, late=0):
    """A mass on a spring that pushes where it is negative, held by a law of position and speed; u, y."""
    rng = np.random.default_rng(seed)
    x = v = r = 0.0
    u, y = np.zeros((2, samples, 1))
    for k in range(samples):
        r = 0.05 * rng.standard_normal() if k % 40 == 0 else r
        y[k] = x + NOISE * rng.standard_normal()
        u[k] = 40.0 * (r - y[k, 0]) - 8.0 * v + 0.3 * rng.standard_normal()
        v += STEP_S * (u[max(k - late, 0), 0] - stiffness * x)
        x += STEP_S * v
    return 5.0 + u, y - 2.0


@pytest.mark.parametrize(("stiffness", "late"), [(-20.0, 0), (-20.0, 2), (0.0, 0), (20.0, 0)])
def test_poles_and_noise_of_a_plant_within_a_loop(stiffness, late):
    u, y = looped(stiffness, late=late)
    model = fit_unstable([(u[:2000], y[:2000])], STEP_S)
    true = np.roots([1.0, STEP_S**2 * stiffness - 2.0, 1.0])
    assert model.order == 2
    assert abs(model.delays[0] - late) <= 1, "a sample moves the output by less than its noise"
    assert np.sort_complex(model.poles) == pytest.approx(np.sort_complex(true.astype(complex)), abs=2e-3)
    unseen = [(u[2000:], y[2000:])]
    ahead = horizon(model, 1000)
    assert ahead == pytest.approx(1.0 / np.log(1.0457), abs=1.0) if stiffness < 0 else ahead == 100
    one, many = (foretold_errors(model, unseen, each)[0] for each in (1, 10))
    assert one == pytest.approx(100.0 * NOISE / y[2000:].std(), rel=0.15)
    assert many < 5.0 * one, "inputs are known, so errors grow slowly"


def test_too_short_a_record_is_told():
    u, y = looped(-20.0, samples=60)
    with pytest.raises(ValueError, match="a part of 60 samples is too short; at least 80 are needed"):
        fit_unstable([(u, y)], STEP_S)
