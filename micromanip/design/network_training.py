"""Free-run least squares for the recurrent network (10)-(12): exact gradients, Levenberg-Marquardt.

Everything here is in scaled signals. Parameters ``theta`` (5 M + 1,), M neurons: a row of three input weights and
the bias of each neuron (4 M), the output weights (M), the output bias. Sample k is, as in the loop (rt.network),

    x_k = [u_k, (u_k - u_m) / step, (y_m - slope u_m) / width]
    y_k = b2 + sum_j w2_j sigma(w1_j . x_k + b1_j),

with the memory point ``(u_m, y_m)``, which moves to ``(u_k, y_k)`` after samples marked as moves. The three inputs
span the same space as (10); in these coordinates the way since the memory point and the width of the loop, both small
against the stroke, have unit size, so that a normal distribution of unit variance is a sensible start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.jit import compiled
from micromanip.rt.network import sigmoid

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_DAMPING, _DAMPING_LOW, _DAMPING_HIGH = 1e-2, 1e-10, 1e8


@dataclass(frozen=True)
class Course:
    """A record for training, all arrays (n,) and scaled.

    `moves` marks the samples after which the memory moves, `weight` is each error's weight in the cost.
    """

    u: Array
    y: Array
    moves: Flags
    weight: Array
    step: float
    slope: float
    width: float

    def restarts(self, moves_a_segment: int) -> Flags:
        """Samples (n,) before which the memory's output is set to the measured one, every so many moves; 0: never."""
        if moves_a_segment == 0:
            return np.zeros(len(self.u), dtype=bool)
        count = np.cumsum(self.moves)
        return np.concatenate(([False], self.moves[:-1] & (count[:-1] % moves_a_segment == 0)))


@compiled
def run_network(theta: Any, neurons: int, scale: Any, u: Any, moves: Any, y0: float, y: Any) -> None:
    """Free run from the memory point ``(u[0], y0)``: outputs to `y` (n,); `scale` is (step, slope, width)."""
    u_memory, y_memory = u[0], y0
    for k in range(len(u)):
        x1, x2 = (u[k] - u_memory) / scale[0], (y_memory - scale[1] * u_memory) / scale[2]
        total = theta[5 * neurons]
        for j in range(neurons):
            i = 4 * j
            total += theta[4 * neurons + j] * sigmoid(
                theta[i] * u[k] + theta[i + 1] * x1 + theta[i + 2] * x2 + theta[i + 3]
            )
        y[k] = total
        if moves[k]:
            u_memory, y_memory = u[k], total


@compiled
def accumulate(
    theta: Any, neurons: int, scale: Any, u: Any, moves: Any, restarts: Any, target: Any, weight: Any, A: Any, g: Any
) -> float:
    """Cost ``sum (weight e)^2``; adds ``J^T J`` to the lower triangle of `A` and ``J^T e`` to `g`.

    Forward sensitivities: ``dy_k/dtheta = direct + (dy_k/dy_m) dy_m/dtheta``; no row of the Jacobian is kept.
    """
    size = 5 * neurons + 1
    row, kept = np.zeros(size), np.zeros(size)
    u_memory, y_memory, cost = u[0], target[0], 0.0
    for k in range(len(u)):
        if restarts[k]:
            y_memory = target[k - 1]
            kept[:] = 0.0
        x1, x2 = (u[k] - u_memory) / scale[0], (y_memory - scale[1] * u_memory) / scale[2]
        total, feedback = theta[5 * neurons], 0.0
        for j in range(neurons):
            i = 4 * j
            z = sigmoid(theta[i] * u[k] + theta[i + 1] * x1 + theta[i + 2] * x2 + theta[i + 3])
            w = theta[4 * neurons + j]
            slope = w * z * (1.0 - z)
            total += w * z
            feedback += slope * theta[i + 2]
            row[i], row[i + 1], row[i + 2], row[i + 3] = slope * u[k], slope * x1, slope * x2, slope
            row[4 * neurons + j] = z
        row[5 * neurons] = 1.0
        feedback /= scale[2]
        for i in range(size):
            row[i] += feedback * kept[i]
        error = weight[k] * (total - target[k])
        cost += error * error
        if not np.isfinite(cost):
            return np.inf
        if weight[k] != 0.0:
            for i in range(size):
                wi = weight[k] * row[i]
                g[i] += wi * error
                wi *= weight[k]
                for j in range(i + 1):
                    A[i, j] += wi * row[j]
        if moves[k]:
            u_memory, y_memory = u[k], total
            kept[:] = row
    return cost


def gradient(theta: Array, neurons: int, course: Course, restarts: Flags) -> tuple[float, Array, Array]:
    """Cost, ``J^T J`` (p, p) and ``J^T e`` (p,), p = 5 `neurons` + 1; half the cost's gradient is the last."""
    A, g = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
    scale = np.array([course.step, course.slope, course.width])
    cost = accumulate(theta, neurons, scale, course.u, course.moves, restarts, course.y, course.weight, A, g)
    return cost, A + np.tril(A, -1).T, g


def levenberg_marquardt(
    theta: Array,
    neurons: int,
    course: Course,
    segment: int,
    iterations: int,
    ridge: float = 0.0,
    tolerance: float = 1e-5,
    progress: Callable[[float], None] | None = None,
) -> tuple[Array, float]:
    """Parameters and cost after at most `iterations` evaluations.

    `segment` moves of the memory make one free run from a measured point (0: the whole record). `ridge` weighs
    ``|theta|^2`` against the sum of squares, so that parameters the record says nothing about stay small. Ends when
    ten accepted steps together gain less than `tolerance` of the cost.
    """
    restarts = course.restarts(segment)

    def evaluate(candidate: Array) -> tuple[float, Array, Array]:
        cost, A, g = gradient(candidate, neurons, course, restarts)
        cost += ridge * float(candidate @ candidate)
        return cost, A + ridge * np.eye(len(candidate)), g + ridge * candidate

    cost, A, g = evaluate(theta)
    damping, history = _DAMPING, [cost]
    for _ in range(iterations):
        if not np.isfinite(cost):
            break
        scale = np.diag(A) + 1e-9 * float(np.max(np.diag(A)))
        step = np.linalg.solve(A + damping * np.diag(scale), -g)
        new_cost, new_A, new_g = evaluate(theta + step)
        if new_cost < cost:
            theta, cost, A, g = theta + step, new_cost, new_A, new_g
            damping = max(_DAMPING_LOW, damping / 4.0)
            history.append(cost)
            if progress is not None:
                progress(cost)
            if len(history) > 10 and history[-11] - cost < tolerance * cost:
                break
        else:
            damping *= 3.0
            if damping > _DAMPING_HIGH:
                break
    return theta, cost
