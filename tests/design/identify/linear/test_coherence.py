"""Multiple coherence, against its closed form."""

import numpy as np
import pytest

from micromanip.design.identify.linear.validated import coherence_of


@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0, 5.0])
def test_coherence_is_the_share_of_the_power_that_the_inputs_explain(noise):
    """Two inputs that are correlated, white noise on each output: ``1 / (1 + noise^2)`` of its power is explained.

    Of the noise two inputs explain two in sixteen averages, more where these overlap.
    """
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(3):
        u = rng.normal(size=(20_000, 2)) @ np.array([[1.0, 0.6], [0.0, 0.8]])
        y = u @ np.array([[1.0, 0.2], [-0.5, 1.0]])
        parts.append((u, y + noise * y.std(axis=0) * rng.normal(size=y.shape)))
    share = 1.0 / (1.0 + noise**2)
    found = coherence_of(parts)
    assert (found >= share - 0.01).all()
    assert (found <= share + (1.0 - share) * 2 / 16 + 0.01).all()
