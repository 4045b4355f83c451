"""Shaping functions phi of the generalised Prandtl-Ishlinskii model, and their inverses.

Affine (15) ``c0 v + c1``; tanh (16) ``c0 tanh(c1 v + c2) + c3``; monotone table, linear between its
points and beyond them along the outermost segments. All are strictly increasing (checked with the
configuration). The tanh inverse exists for ``|(u - c3)/c0| < 1`` only: the caller clips the
displacement to the attainable range first, the guard here merely keeps the result finite.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

IDENTITY, AFFINE, TANH, TABLE = 0, 1, 2, 3
_OPEN_INTERVAL = 1.0 - 1e-12

MAX_TABLE = 64

SHAPING = record(
    ("kind", "i8"), ("c", "f8", (4,)), ("points", "i8"), ("v", "f8", (MAX_TABLE,)), ("u", "f8", (MAX_TABLE,))
)


@compiled
def interpolate(x_table: Any, y_table: Any, points: int, x: float) -> float:
    """Value at `x` of the line through ``points`` rising support points, extended at both ends."""
    low, high = 0, points - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if x_table[middle] <= x:
            low = middle
        else:
            high = middle
    slope = (y_table[high] - y_table[low]) / (x_table[high] - x_table[low])
    return y_table[low] + slope * (x - x_table[low])


@compiled
def shape(p: Record, v: float) -> float:
    """phi(v): voltage (V) to the play operators' input (um)."""
    kind = p["kind"]
    if kind == TANH:
        return p["c"][0] * math.tanh(p["c"][1] * v + p["c"][2]) + p["c"][3]
    if kind == AFFINE:
        return p["c"][0] * v + p["c"][1]
    if kind == TABLE:
        return interpolate(p["v"], p["u"], p["points"], v)
    return v


@compiled
def unshape(p: Record, u: float) -> float:
    """phi^-1(u): play operators' input (um) to voltage (V)."""
    kind = p["kind"]
    if kind == TANH:
        ratio = (u - p["c"][3]) / p["c"][0]
        ratio = max(-_OPEN_INTERVAL, min(_OPEN_INTERVAL, ratio))
        return (math.atanh(ratio) - p["c"][2]) / p["c"][1]
    if kind == AFFINE:
        return (u - p["c"][1]) / p["c"][0]
    if kind == TABLE:
        return interpolate(p["u"], p["v"], p["points"], u)
    return u
