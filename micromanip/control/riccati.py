"""The stabilising solution of the discrete algebraic Riccati equation, for gains of filters and regulators.

    P = A' P A - A' P B (R + B' P B)^-1 B' P A + Q

by structured doubling (Chu, Fan, Lin, Wang, Int. J. Control 77, 2004): after k steps H is the value of a horizon of 2^k
steps, so a dozen steps are enough where the slowest closed pole is at .999. scipy's solver gives the same with a QZ
decomposition, in three times the time, and its import is a quarter of the host's start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

_STEPS = 60
_SETTLED, _RESIDUAL = 1e-14, 1e-7


def solve_riccati(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """P (n, n) for A (n, n), B (n, m), symmetric Q (n, n) and positive definite R (m, m).

    Raises LinAlgError where there is none that stabilises, or where it is not found to single precision.
    """
    own = np.eye(len(A))
    step, G, H = A, B @ np.linalg.solve(R, B.T), Q
    with np.errstate(all="ignore"):  # what overflows is judged at the end
        for _ in range(_STEPS):
            both = np.linalg.solve(own + G @ H, np.hstack([step, G]))
            onward, gained = both[:, : len(A)], both[:, len(A) :]
            added = step.T @ H @ onward
            G, H = G + step @ gained @ step.T, H + added
            step = step @ onward
            G, H = 0.5 * (G + G.T), 0.5 * (H + H.T)
            if not np.abs(added).max() > _SETTLED * np.abs(H).max():
                break
        through = B.T @ H @ A
        left = A.T @ H @ A - H - through.T @ np.linalg.solve(R + B.T @ H @ B, through) + Q
    if not np.abs(left).max() <= _RESIDUAL * np.abs(H).max():
        raise np.linalg.LinAlgError("the Riccati equation has no solution that stabilises, or is too badly scaled")
    return H
