"""Mechanics of one axis, two masses or three, discretised exactly for inputs held over a sub-step.

Actuator mass driven by the stack's stiffness, lever and flexure to the stage, guide to ground. States:
actuator position and velocity, stage position and velocity, strain-gauge reading (first order on the actuator
position), and position and velocity of the second mode's mass where there is one; inputs: free displacement of the
stack (um) and force on the stage (N).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .options import Plant

Matrix = NDArray[np.float64]

_STRAIN_HZ = 2500.0
"""Bandwidth of the strain gauge."""


def continuous(plant: Plant) -> tuple[Matrix, Matrix]:
    """``x' = A x + B [u, F]`` in um, s and N; all modes have the damping ratio of `plant`."""
    kp, kf, kg, n = plant.piezo_N_per_um, plant.flexure_N_per_um, plant.guide_N_per_um, plant.lever
    stiffness = np.array([[kp + n * n * kf, -n * kf], [-n * kf, kf + kg]])
    mass = np.array([plant.actuator_kg, plant.stage_kg])
    if plant.second_mode is not None:
        stiffness, mass = _with_second(plant, stiffness, mass)
    dynamic = 1e6 * stiffness / mass[:, None]
    squares, modes = np.linalg.eig(dynamic)
    damper = modes @ np.diag(2.0 * plant.damping * np.sqrt(squares)) @ np.linalg.inv(modes)
    places = [0, 2, 5][: len(mass)]
    speeds, size = [place + 1 for place in places], 1 + 2 * len(mass)
    a, b = np.zeros((size, size)), np.zeros((size, 2))
    a[places, speeds] = 1.0
    a[np.ix_(speeds, places)] = -dynamic
    a[np.ix_(speeds, speeds)] = -damper
    a[4, 0], a[4, 4] = 2.0 * np.pi * _STRAIN_HZ, -2.0 * np.pi * _STRAIN_HZ
    b[1, 0] = 1e6 * kp / mass[0]
    b[3, 1] = 1e6 / mass[1]
    return a, b


def _with_second(plant: Plant, stiffness: Matrix, mass: Matrix) -> tuple[Matrix, Matrix]:
    """Stiffness (3, 3) and masses (3,) with the second mode's mass, on its spring from the lever."""
    second = plant.second_mode
    assert second is not None
    first_square = float(np.min(np.linalg.eigvals(stiffness / mass[:, None])))
    spring, n = second.stiffness_share * plant.flexure_N_per_um, plant.lever
    whole = np.zeros((3, 3))
    whole[:2, :2] = stiffness
    whole[0, 0] += n * n * spring
    whole[0, 2] = whole[2, 0] = -n * spring
    whole[2, 2] = spring
    return whole, np.append(mass, spring / (second.ratio**2 * first_square))


def discrete(plant: Plant, step_s: float) -> tuple[Matrix, Matrix]:
    """Exact zero-order-hold discretisation of `continuous` over `step_s`."""
    a, b = continuous(plant)
    size = len(a)
    block, unit = np.zeros((size + 2, size + 2)), np.ones(size + 2)
    block[:size, :size], block[:size, size:] = a, b
    unit[[1, 3, *range(6, size)]] = step_s  # speeds in um a step: all entries are of similar size
    advanced = _exponential(block * step_s * unit[:, None] / unit) / unit[:, None] * unit
    return advanced[:size, :size].copy(), advanced[:size, size:].copy()


def _exponential(exponent: Matrix) -> Matrix:
    """Of a matrix: Taylor's series of a small part of it, which is squared as often as it was halved.

    As near as scipy's, whose import would be an eighth of what a start of the simulated cell computes.
    """
    halvings = max(0, int(np.ceil(np.log2(np.abs(exponent).sum(axis=1).max()))) + 1)
    term = exponent / 2.0**halvings
    change, part = term, term  # the identity stays outside: a slow mode would drown in it
    for order in range(2, 16):
        term = term @ part / order
        change = change + term
    for _ in range(halvings):
        change = 2.0 * change + change @ change
    return np.eye(len(exponent)) + change


def compliance(plant: Plant) -> float:
    """How far (um) the stage moves for a force of 1 N on it, at rest, the stack neither driven nor held."""
    a, b = continuous(plant)
    return float(np.linalg.solve(a, -b[:, 1])[2])


def rest(plant: Plant) -> Matrix:
    """State at rest for a free displacement of 1 um and no force."""
    a, b = continuous(plant)
    return np.asarray(np.linalg.solve(a, -b[:, 0]), dtype=np.float64)
