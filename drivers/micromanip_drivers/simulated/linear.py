"""The linear part of one simulated axis per period of the loop: what ``plant.py`` steps, at a slope of 1 um per V.

One sub-step, with the amplifier's voltage a, creep c_k and mechanics x:

    a+ = a + h_a (V - a),   p = a+ + n,   c_k+ = c_k + h_k (g p - c_k),   x+ = M x + b (p (1 - K g) + sum c_k+) + f F

Hysteresis is left out (its slope is the caller's), and so are the amplifier's limits.
"""

from __future__ import annotations

import math

import numpy as np

from micromanip.driver import LinearPlant

from . import mechanics
from .options import Plant
from .records import CREEP_TIMES_S, SUBSTEPS


def linear_plant(plant: Plant, period_s: float, *, creep: bool) -> LinearPlant:
    """States: amplifier, creep operators (where `creep`), mechanics; inputs as of LinearPlant."""
    step_s = period_s / SUBSTEPS
    moved, driven = mechanics.discrete(plant, step_s)
    lags = -np.expm1(-step_s / CREEP_TIMES_S) if creep else np.zeros(0)
    gain = plant.creep_per_operator if creep else 0.0
    k, first = len(lags), 1 + len(lags)
    size = first + len(moved)
    amplifier = -math.expm1(-step_s * 2.0 * math.pi * plant.amplifier_Hz)
    # rows: what is the stack's pure displacement p of states and (V, F, n); then all that it drives
    p_x, p_u = np.zeros(size), np.array([amplifier, 0.0, 1.0])
    p_x[0] = 1.0 - amplifier
    A, B = np.zeros((size, size)), np.zeros((size, 3))
    A[0], B[0, 0] = p_x, amplifier
    A[1:first, 1:first] = np.diag(1.0 - lags)
    A[1:first] += gain * np.outer(lags, p_x)
    B[1:first] = gain * np.outer(lags, p_u)
    free_x = (1.0 - k * gain) * p_x + A[1:first].sum(axis=0)
    free_u = (1.0 - k * gain) * p_u + B[1:first].sum(axis=0)
    A[first:, first:] = moved
    A[first:] += np.outer(driven[:, 0], free_x)
    B[first:] = np.outer(driven[:, 0], free_u)
    B[first:, 1] += driven[:, 1]
    whole, held = np.eye(size), np.zeros((size, 3))
    for _ in range(SUBSTEPS):
        whole, held = A @ whole, A @ held + B
    strain, stage = np.zeros(size), np.zeros(size)
    strain[first + 4] = stage[first + 2] = 1.0
    if plant.second_mode is not None:
        stage[first + 5] = plant.second_mode.gain
        stage[first] = -plant.second_mode.gain * plant.lever
    # the noise of each sub-step is its own: that of a period, the same in both, is smaller by the root of their number
    noise = held[:, 2] / math.sqrt(SUBSTEPS)
    return LinearPlant(whole, held[:, 0], held[:, 1], noise, strain, stage, plant.late_cycles)
