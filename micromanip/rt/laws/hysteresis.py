"""Hysteresis of one actuator: play operator, generalised Prandtl-Ishlinskii model and its inverse.

Play operator (2)-(3), model (6), inverse (7)-(9); the recurrent-network inverse (10)-(12) is in
``network.py``. Displacements in um, voltages in V.

The inverse exists while every partial sum ``alpha + rho_1 + .. + rho_i`` is positive and the
``r_hat`` increase; ``micromanip.settings`` refuses a model that breaks this.

Shaping functions phi: affine (15) ``c0 v + c1``; tanh (16) ``c0 tanh(c1 v + c2) + c3``; monotone table, linear between
its points and beyond them along the outermost segments. All are strictly increasing (checked with the configuration).
The tanh inverse exists for ``|(u - c3)/c0| < 1`` only: the caller clips the displacement to the attainable range first,
the guard here merely keeps the result finite.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record, record

IDENTITY, AFFINE, TANH, TABLE = 0, 1, 2, 3
_OPEN_INTERVAL = 1.0 - 1e-12

MAX_TABLE = 64

SHAPING = record(
    ("kind", "i8"), ("c", "f8", (4,)), ("points", "i8"), ("v", "f8", (MAX_TABLE,)), ("u", "f8", (MAX_TABLE,))
)

MAX_PLAYS = 32

PLAYS: tuple[Field, ...] = (
    ("shaping", SHAPING),
    ("plays", "i8"),
    ("alpha", "f8"),
    ("r", "f8", (MAX_PLAYS,)),
    ("rho", "f8", (MAX_PLAYS,)),
    ("r_hat", "f8", (MAX_PLAYS,)),
    ("rho_hat", "f8", (MAX_PLAYS,)),
)
"""Parameters: thresholds (um) and weights of model and inverse."""
PLAYS_STATE: tuple[Field, ...] = (("z", "f8", (MAX_PLAYS,)),)
"""Outputs (um) of the inverse's play operators."""


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


@compiled
def play(x: float, r: float, w: float) -> float:
    """Play operator, equation (2): output after input `x`, threshold `r`, from output `w`."""
    return max(x - r, min(x + r, w))


@compiled
def model_output(p: Record, w: Any, v: float) -> float:
    """Displacement (um) of model (6) after voltage `v`; advances the play states `w` (on phi(v))."""
    u = shape(p["shaping"], v)
    y = p["alpha"] * u
    for i in range(p["plays"]):
        w[i] = play(u, p["r"][i], w[i])
        y += p["rho"][i] * w[i]
    return y


@compiled
def inverse_plays(p: Record, z: Any, y: float, widening: float) -> float:
    """Argument of phi^-1 in (7), in um, for displacement `y`; advances the play states `z`.

    `widening` (um, 0 without rate dependence) is added to every threshold: thresholds ``r_i + e`` of the
    model are ``r_hat_i + alpha e`` of its inverse, the weights (9) stay.
    """
    u = y / p["alpha"]
    for i in range(p["plays"]):
        z[i] = play(y, p["r_hat"][i] + widening, z[i])
        u += p["rho_hat"][i] * z[i]
    return u


@compiled
def inverse_parameters(p: Record) -> None:
    """Fill ``r_hat`` (8) and ``rho_hat`` (9) of `p` from ``alpha``, ``r`` and ``rho``."""
    before = p["alpha"]
    for i in range(p["plays"]):
        r_hat = p["alpha"] * p["r"][i]
        for j in range(i):
            r_hat += p["rho"][j] * (p["r"][i] - p["r"][j])
        after = before + p["rho"][i]
        p["r_hat"][i] = r_hat
        p["rho_hat"][i] = -p["rho"][i] / (after * before)
        before = after


@compiled
def inverse_state(p: Record, w: Any, z: Any) -> None:
    """State `z` of the exact inverse of a model whose play states are `w` (any admissible ones).

    ``z_i = (alpha + sum_{j<=i} rho_j) w_i + sum_{j>i} rho_j w_j``. From any other state the inverse is wrong by
    micrometres until the states have been wiped out.
    """
    tail = 0.0
    partial = p["alpha"]
    for i in range(p["plays"]):
        partial += p["rho"][i]
    for i in range(p["plays"] - 1, -1, -1):
        z[i] = partial * w[i] + tail
        tail += p["rho"][i] * w[i]
        partial -= p["rho"][i]


@compiled
def admit(p: Record, z: Any, y: float) -> None:
    """Move the inverse's states `z` into the admissible set around displacement `y` (um).

    Admissible is ``|z_1 - y| <= r_hat_1`` and ``|z_{i+1} - z_i| <= r_hat_{i+1} - r_hat_i``: the
    only states that an input history can leave behind.
    """
    inner, r_inner = y, 0.0
    for i in range(p["plays"]):
        z[i] = play(inner, p["r_hat"][i] - r_inner, z[i])
        inner, r_inner = z[i], p["r_hat"][i]
