"""A model is the same wherever a sensor has its zero."""

import numpy as np
import pytest

from micromanip.design.identify.hysteresis import fit, structure_of


def test_the_model_is_the_same_but_for_its_offset():
    t = 0.005 * np.arange(1200)
    v = 50.0 + 30.0 * np.sin(2 * np.pi * 0.9 * t) * (1.0 + 0.2 * np.sin(2.0 * t))
    y = 0.8 * v + 5.0 * np.sin(2 * np.pi * 0.9 * t - 0.6)
    plain = fit(structure_of("pi-tanh", v, 0.005, 5), v, y, (-1e4, 1e4), 50, starts=3)
    other = fit(structure_of("pi-tanh", v, 0.005, 5), v, y + 400.0, (-1e4, 1e4), 50, starts=3)
    assert other.model.weights == pytest.approx(plain.model.weights, rel=1e-9)
    np.testing.assert_allclose(other.predict(v), plain.predict(v) + 400.0, rtol=0, atol=1e-6)
