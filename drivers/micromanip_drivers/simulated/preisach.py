"""Hysteresis of the piezo stack: a Preisach operator with a closed-form Everett function.

Density ``c exp(-d r) (1 + k1 m + k2 m^2)`` with ``r = (a-b)/2`` and ``m = ((a+b)/2 - 60 V)/75 V``. The
memory is a stack of alternating extrema with wipe-out, so return-point memory is exact and a step costs one
Everett integral. It is deliberately not the model class that the controller inverts.
"""

from __future__ import annotations

import math
from typing import Any

from .records import STACK, compiled

_CENTRE_V, _WIDTH_V = 60.0, 75.0
SATURATION_V = -20.0
"""Negative saturation."""


@compiled
def everett(p: Any, a: float, b: float) -> float:
    """Integral (um) of the density over the triangle of switching pairs between `b` and `a` >= `b` (V)."""
    half = 0.5 * (a - b)
    middle = (0.5 * (a + b) - _CENTRE_V) / _WIDTH_V
    d = p["d"]
    x = d * half
    if x < 0.05:
        f1 = half * half * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0))))
        f3 = half**4 * (0.25 - x * (1.0 / 20.0 - x * (1.0 / 120.0 - x / 840.0)))
    else:
        e = math.exp(-x)
        f1 = (x - 1.0 + e) / (d * d)
        f3 = (x * (x * (x - 3.0) + 6.0) - 6.0 + 6.0 * e) / d**4
    weight = 1.0 + p["k1"] * middle + p["k2"] * middle * middle
    return p["c"] * (2.0 * f1 * weight + 2.0 / 3.0 * p["k2"] * f3 / (_WIDTH_V * _WIDTH_V))


@compiled
def reset_memory(s: Any) -> None:
    """Negative saturation: the memory is empty."""
    s["depth"] = 1
    s["extremum_V"][0] = SATURATION_V
    s["output_um"][0] = 0.0
    s["input_V"] = SATURATION_V
    s["merged"] = 0


@compiled
def _branch(p: Any, s: Any, v: float) -> float:
    """Irreversible output at input `v` on the branch that leaves the newest extremum."""
    top = s["depth"] - 1
    turned = s["extremum_V"][top]
    if top % 2 == 0:
        return s["output_um"][top] + everett(p, v, turned)
    return s["output_um"][top] - everett(p, turned, v)


@compiled
def _remember(p: Any, s: Any) -> None:
    """The input turns: its last value becomes an extremum. A full stack forgets its smallest loop."""
    if s["depth"] == STACK:
        s["depth"] -= 2
        s["merged"] += 1
    v = s["input_V"]
    s["output_um"][s["depth"]] = _branch(p, s, v)
    s["extremum_V"][s["depth"]] = v
    s["depth"] += 1


@compiled
def preisach_step(p: Any, s: Any, v: float) -> float:
    """Displacement (um) after input `v` (V): irreversible part from the memory plus reversible part."""
    v = max(v, SATURATION_V)
    rising = (s["depth"] - 1) % 2 == 0
    if (rising and v < s["input_V"]) or (not rising and v > s["input_V"]):
        _remember(p, s)
        rising = not rising
    while s["depth"] >= 2:
        previous = s["extremum_V"][s["depth"] - 2]
        if (rising and v >= previous) or (not rising and v <= previous):
            s["depth"] = max(1, s["depth"] - 2)
            rising = (s["depth"] - 1) % 2 == 0
        else:
            break
    s["input_V"] = v
    r = p["reversible"]
    return _branch(p, s, v) + v * (r[0] + v * (r[1] + v * r[2]))


@compiled
def bouc_wen_step(p: Any, s: Any, v: float) -> float:
    """Free displacement (um) at `v` (V), a sub-step after the one before, of another class of hysteresis: Bouc-Wen.

    ``w = linear v + square v^2 - z``, ``dz = (fall - (with_sign sgn(dv z) + without_sign) |z|) dv``, and a share of `w`
    follows through a first-order lag: the faster, the wider the loop. Wen, J. Eng. Mech. Div. 102 (1976).
    """
    change, z = v - s["input_V"], s["internal_um"]
    same = 1.0 if change * z >= 0.0 else -1.0
    z += (p["fall"] - (p["with_sign"] * same + p["without_sign"]) * abs(z)) * change
    s["input_V"], s["internal_um"] = v, z
    whole = p["linear"] * v + p["square"] * v * v - z
    s["lagging_um"] += p["lag_step"] * (whole - s["lagging_um"])
    return (1.0 - p["lag_share"]) * whole + p["lag_share"] * s["lagging_um"]
