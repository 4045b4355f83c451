"""Whether an outer loop comes to rest from a large swing, where the set-point's slew limit binds.

Margins are of small signals. A set-point that runs at its slew limit lags by up to 90 degrees more, and a regulator
that is fast around a slow mode can then drive the mode instead of damping it: a blow, or some milliseconds in which the
loop stands still, and the stage swings from end to end for good. So each design is played: its model, with the mode
swinging, under its own filter and regulator, within slew limit and range.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.control.outer_gains import OuterGains
from micromanip.rt.jit import Compiler

compiled = Compiler(__file__, allocates=True)

_SHARES = np.array([0.5, 0.25, 0.125])
"""Swings that must die out, in terms of what the set-point's reach moves the stage by."""
_PLAYED_S, _LOOKED_AT, _LEFT = 0.2, 0.2, 0.5
"""Time that is played; the share of it at the end in which no more than so much of the swing may be left."""


@dataclass(frozen=True)
class Reach:
    """What the set-point can do: um in a cycle, and um to the nearer end of its range from the working point."""

    slew_um: float
    range_um: float


def comes_to_rest(gains: OuterGains, states: int, reach: Reach, period_s: float) -> bool:
    """Whether swings of the least damped mode of the model's first `states` die out; True where it has none."""
    A, B, C, K, L = gains.A, gains.B, gains.C, gains.feedback, gains.observer
    values, vectors = np.linalg.eig(A[:states, :states])
    swinging = np.flatnonzero(values.imag > 0.0)
    if len(swinging) == 0:
        return True
    vector = vectors[:, swinging[np.argmax(np.abs(values[swinging]))]]
    seen = C[:states] @ vector
    if np.abs(seen) == 0.0:
        return True
    entering = A[:states, gains.controllable]  # as the disturbance does: the set-point, its delay over
    static = float(C[:states] @ np.linalg.solve(np.eye(states) - A[:states, :states], entering))
    swings_um = _SHARES * abs(static) * reach.range_um
    largest = np.zeros(len(swings_um))
    for k, swing_um in enumerate(swings_um):
        x = np.zeros(len(A))
        x[:states] = np.real(vector / seen) * swing_um
        largest[k] = _largest(A, B, C, K, L, x, reach.slew_um, reach.range_um, round(_PLAYED_S / period_s))
    return bool((largest < _LEFT * swings_um).all())


@compiled
def _largest(A: Any, B: Any, C: Any, K: Any, L: Any, x: Any, slew_um: float, range_um: float, count: int) -> float:
    """Largest output towards the end of `count` cycles, from the state `x` (n,), which the filter knows."""
    size, begin = len(x), (1.0 - _LOOKED_AT) * count
    estimate, later, other = np.empty(size), np.empty(size), np.empty(size)
    for i in range(size):
        estimate[i] = x[i]
    u = largest = 0.0
    for cycle in range(count):
        y = expected = 0.0
        for i in range(size):
            y += C[i] * x[i]
            expected += C[i] * estimate[i]
        wanted = 0.0
        for i in range(size):
            estimate[i] += L[i] * (y - expected)
            wanted -= K[i] * estimate[i]
        wanted = min(max(wanted, -range_um), range_um)
        u = min(max(wanted, u - slew_um), u + slew_um)
        for i in range(size):
            real = expected = B[i] * u
            for j in range(size):
                real += A[i, j] * x[j]
                expected += A[i, j] * estimate[j]
            later[i], other[i] = real, expected
        for i in range(size):
            x[i], estimate[i] = later[i], other[i]
        if cycle >= begin:
            largest = max(largest, abs(y))
    return largest
