"""Free-run least squares for the recurrent network (10)-(12): exact gradients, Levenberg-Marquardt.

Everything here is in scaled signals. With the memory point ``(u_m, y_m)``, P pairs of neurons and one for the line

    d = (u_k - u_m) / step,   h = (y_m - slope u_m) / width,   a_j = p_j u_m + q_j h + b_j
    y_k = y_m + c d + sum_j w_j (sigma(a_j + g_j d) - sigma(a_j))

This is (12) with M = 2 P + 1 neurons, half of whose weights are tied so that every branch *begins at the memory point*:
free weights leave a jump there, which the loop would put on the voltage, and a drift at rest. Parameters ``theta``
(5 P + 1,): rows ``p, q, g, b, w`` of the pairs, then c. In these coordinates everything is of unit size, so that a
normal distribution is a sensible start. The memory moves to ``(u_k, y_k)`` after samples that are marked as moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.rt.jit import Compiler
from micromanip.rt.laws.network import sigmoid

Flags = NDArray[np.bool_]
compiled = Compiler(__file__, allocates=True)

_DAMPING, _DAMPING_LOW, _DAMPING_HIGH = 1e-2, 1e-10, 1e8
_PATIENCE, _TOLERANCE = 10, 1e-4
_RIDGE = 1e-3
"""Weighs ``|theta|^2`` against the sum of squares: weights stay small that the record says nothing about."""


@dataclass(frozen=True)
class Course:
    """A record for training, all arrays (n,) and scaled.

    `moves` marks the samples after which the memory moves, `weight` is each error's weight in the cost. The free run
    begins on the mean line ``y = slope u``: a record may begin far outside its loop.
    """

    u: Array
    y: Array
    moves: Flags
    weight: Array
    step: float
    slope: float
    width: float

    @property
    def scale(self) -> Array:
        """(step, slope, width) of the module's equations."""
        return np.array([self.step, self.slope, self.width])

    def restarts(self, segment: int) -> Flags:
        """Samples (n,) before which the memory's output is set to the measured one, every `segment` moves; 0: never."""
        if segment == 0:
            return np.zeros(len(self.u), dtype=bool)
        count = np.cumsum(self.moves)
        return np.concatenate(([False], self.moves[:-1] & (count[:-1] % segment == 0)))


@compiled
def mark_reversals(u: Any, reversal: float, moves: Any) -> None:
    """Mark in `moves` (n,) each sample of `u` (n,) before that at which `u` has come back by more than `reversal`."""
    extreme, direction = u[0], 0.0
    for k in range(1, len(u)):
        way = u[k] - extreme
        if direction * way >= 0.0 and way != 0.0:
            if direction == 0.0:
                direction = 1.0 if way > 0.0 else -1.0
            extreme = u[k]
        elif abs(way) > reversal:
            moves[k - 1] = True
            extreme, direction = u[k], -direction


@compiled
def run_network(theta: Any, scale: Any, u: Any, moves: Any, y0: float, y: Any) -> None:
    """Free run from the memory point ``(u[0], y0)``: outputs to `y` (n,); `scale` is (step, slope, width)."""
    size = len(theta)
    u_memory, y_memory = u[0], y0
    for k in range(len(u)):
        d, h = (u[k] - u_memory) / scale[0], (y_memory - scale[1] * u_memory) / scale[2]
        total = y_memory + theta[size - 1] * d
        for i in range(0, size - 1, 5):
            a = theta[i] * u_memory + theta[i + 1] * h + theta[i + 3]
            total += theta[i + 4] * (sigmoid(a + theta[i + 2] * d) - sigmoid(a))
        y[k] = total
        if moves[k]:
            u_memory, y_memory = u[k], total


@compiled
def accumulate(
    theta: Any, scale: Any, u: Any, moves: Any, restarts: Any, target: Any, weight: Any, A: Any, g: Any
) -> float:
    """Cost ``sum (weight e)^2``; adds ``J^T J`` to the lower triangle of `A` and ``J^T e`` to `g`.

    Forward sensitivities: ``dy_k/dtheta = direct + (dy_k/dy_m) dy_m/dtheta``; no row of the Jacobian is kept.
    """
    size = len(theta)
    row, kept = np.zeros(size), np.zeros(size)
    u_memory, y_memory, cost = u[0], scale[1] * u[0], 0.0
    for k in range(len(u)):
        if restarts[k]:
            y_memory = target[k - 1]
            for i in range(size):
                kept[i] = 0.0
        d, h = (u[k] - u_memory) / scale[0], (y_memory - scale[1] * u_memory) / scale[2]
        total, feedback = y_memory + theta[size - 1] * d, 0.0
        row[size - 1] = d
        for i in range(0, size - 1, 5):
            a = theta[i] * u_memory + theta[i + 1] * h + theta[i + 3]
            start, end = sigmoid(a), sigmoid(a + theta[i + 2] * d)
            w = theta[i + 4]
            at_end = w * end * (1.0 - end)
            both = at_end - w * start * (1.0 - start)
            total += w * (end - start)
            feedback += both * theta[i + 1]
            row[i], row[i + 1], row[i + 2] = both * u_memory, both * h, at_end * d
            row[i + 3], row[i + 4] = both, end - start
        feedback = 1.0 + feedback / scale[2]
        for i in range(size):
            row[i] += feedback * kept[i]
        error = weight[k] * (total - target[k])
        cost += error * error
        if not math.isfinite(cost):
            return math.inf
        if weight[k] != 0.0:
            for i in range(size):
                value = weight[k] * row[i]
                g[i] += value * error
                value *= weight[k]
                for j in range(i + 1):
                    A[i, j] += value * row[j]
        if moves[k]:
            u_memory, y_memory = u[k], total
            for i in range(size):  # numba takes longer to compile an assignment of slices
                kept[i] = row[i]
    return cost


def gradient(theta: Array, course: Course, restarts: Flags) -> tuple[float, Array, Array]:
    """Cost, ``J^T J`` (p, p) and ``J^T e`` (p,), p parameters: half the cost's gradient is the last."""
    A, g = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
    cost = accumulate(theta, course.scale, course.u, course.moves, restarts, course.y, course.weight, A, g)
    return cost, A + np.tril(A, -1).T, g


def levenberg_marquardt(theta: Array, course: Course, segment: int, evaluations: int) -> Array:
    """Parameters (p,) after at most so many `evaluations` of the cost, from `theta` (p,).

    `segment` moves of the memory make one free run from a measured point (0: the whole record). Ends early when ten
    accepted steps together gain too little of the cost, or none is accepted however short.
    """
    restarts = course.restarts(segment)

    def evaluate(candidate: Array) -> tuple[float, Array, Array]:
        cost, A, g = gradient(candidate, course, restarts)
        return cost + _RIDGE * float(candidate @ candidate), A + _RIDGE * np.eye(len(candidate)), g + _RIDGE * candidate

    cost, A, g = evaluate(theta)
    damping, history = _DAMPING, [cost]
    for _ in range(evaluations):
        if not np.isfinite(cost) or damping > _DAMPING_HIGH:
            break
        diagonal = np.diag(A) + 1e-9 * float(np.max(np.diag(A)))
        candidate = theta + np.linalg.solve(A + damping * np.diag(diagonal), -g)
        new_cost, new_A, new_g = evaluate(candidate)
        if not new_cost < cost:
            damping *= 3.0
            continue
        theta, cost, A, g = candidate, new_cost, new_A, new_g
        damping = max(_DAMPING_LOW, damping / 4.0)
        history.append(cost)
        if len(history) > _PATIENCE and history[-1 - _PATIENCE] - cost < _TOLERANCE * cost:
            break
    return theta
