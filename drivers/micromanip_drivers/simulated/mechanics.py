"""Two-mass mechanics of one axis, discretised exactly for inputs held over a sub-step.

Actuator mass driven by the stack's stiffness, lever and flexure to the stage, guide to ground. States:
actuator position and velocity, stage position and velocity, strain-gauge reading (first order on
the actuator position); inputs: free displacement of the stack (um) and force on the stage (N).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .options import Plant

Matrix = NDArray[np.float64]


def continuous(plant: Plant) -> tuple[Matrix, Matrix]:
    """``x' = A x + B [u, F]`` in um, s and N; both modes have the damping ratio of `plant`."""
    kp, kf, kg, n = plant.piezo_N_per_um, plant.flexure_N_per_um, plant.guide_N_per_um, plant.lever
    stiffness = np.array([[kp + n * n * kf, -n * kf], [-n * kf, kf + kg]])
    mass = np.array([plant.actuator_kg, plant.stage_kg])
    dynamic = 1e6 * stiffness / mass[:, None]
    squares, modes = np.linalg.eig(dynamic)
    damper = modes @ np.diag(2.0 * plant.damping * np.sqrt(squares)) @ np.linalg.inv(modes)
    a, b = np.zeros((5, 5)), np.zeros((5, 2))
    a[0, 1] = a[2, 3] = 1.0
    a[np.ix_([1, 3], [0, 2])] = -dynamic
    a[np.ix_([1, 3], [1, 3])] = -damper
    a[4, 0], a[4, 4] = 2.0 * np.pi * plant.strain_Hz, -2.0 * np.pi * plant.strain_Hz
    b[1, 0] = 1e6 * kp / mass[0]
    b[3, 1] = 1e6 / mass[1]
    return a, b


def discrete(plant: Plant, step_s: float) -> tuple[Matrix, Matrix]:
    """Exact zero-order-hold discretisation of `continuous` over `step_s`."""
    from scipy.linalg import expm  # not for the loop's process, which only computes with what comes out

    a, b = continuous(plant)
    block = np.zeros((7, 7))
    block[:5, :5], block[:5, 5:] = a, b
    advanced = expm(block * step_s)
    return advanced[:5, :5].copy(), advanced[:5, 5:].copy()


def rest(plant: Plant) -> Matrix:
    """State at rest for a free displacement of 1 um and no force."""
    a, b = continuous(plant)
    return np.asarray(np.linalg.solve(a, -b[:, 0]), dtype=np.float64)
