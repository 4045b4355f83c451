"""The Riccati equation by doubling beside scipy's solver, and where there is no solution."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from micromanip.control.riccati import solve_riccati


@given(seed=st.integers(0, 2**31), states=st.integers(1, 20), radius=st.floats(0.1, 1.2), price=st.floats(-6.0, 6.0))
def test_it_is_scipys(seed, states, radius, price):
    """Stable or not, feedback cheap or dear; on the unit circle, too."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((states, 1)), rng.standard_normal((states, states))
    about = A, B, C.T @ C, np.array([[10.0**price]])
    expected = solve_discrete_are(*about)
    found = solve_riccati(*about)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-8 * np.abs(expected).max())
    gain = np.linalg.solve(about[3] + B.T @ found @ B, B.T @ found @ A)
    assert np.abs(np.linalg.eigvals(A - B @ gain)).max() < 1.0


@pytest.mark.parametrize(
    ("A", "B"),
    [(np.diag([0.5, 1.1]), [[1.0], [0.0]]), (np.full((2, 2), np.nan), [[1.0], [1.0]])],
    ids=["out of reach, and growing", "no numbers"],
)
def test_where_nothing_stabilises_it_says_so(A, B):
    with pytest.raises(np.linalg.LinAlgError):
        solve_riccati(A, np.array(B), np.eye(2), np.eye(1))


def test_where_doubling_loses_its_digits_the_answer_is_still_right():
    """An integrator's chain in states of very different size, and a price that hardly limits anything."""
    states = 8
    A = np.eye(states) + np.diag(np.full(states - 1, 1e-4), 1)
    scale = np.geomspace(1.0, 1e12, states)
    A, B = A * scale[:, None] / scale[None, :], np.zeros((states, 1))
    B[-1] = scale[-1] * 1e-4
    about = A, B, np.eye(states), np.array([[1e-3]])
    found, expected = solve_riccati(*about), solve_discrete_are(*about)
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-7 * np.abs(expected).max())
