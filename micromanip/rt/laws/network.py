"""Recurrent-network inverse of the hysteresis, equations (10)-(12), displacement to voltage.

Input ``X = [y_k, y_m, v_m]``, one hidden layer of sigmoid neurons, output ``v_k`` (section 3.4: y as the input, v as
the output). Weights are in physical units (um, V): the scaling used in training is folded into them.

The memory ``(y_m, v_m)`` is the last turning point of y, where the paper has the sample before: it is the sample before
y has returned by more than ``reversal_um`` from its extreme. The branch that leaves a turning point is a smooth
function of y alone, at any speed and any loop rate (``design/identify/network/model.py`` trains just that).
"""

from __future__ import annotations

import math

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record

MAX_NEURONS = 32

NEURONS: tuple[Field, ...] = (
    ("neurons", "i8"),
    ("reversal_um", "f8"),
    ("w_in", "f8", (MAX_NEURONS, 3)),
    ("b_in", "f8", (MAX_NEURONS,)),
    ("w_out", "f8", (MAX_NEURONS,)),
    ("b_out", "f8"),
)
"""Parameters."""
NEURONS_STATE: tuple[Field, ...] = (
    ("y_memory", "f8"),
    ("v_memory", "f8"),
    ("y_last", "f8"),
    ("v_last", "f8"),
    ("y_extreme", "f8"),
    ("direction", "f8"),
)
"""The last turning point (um, V), the cycle before, the extreme since that turning point, and the direction (-1, 1)."""


@compiled
def sigmoid(x: float) -> float:
    """Activation of (11), ``1/(1 + exp(-x))``; finite for any finite `x`."""
    return 1.0 / (1.0 + math.exp(-x)) if x > -700.0 else 0.0


@compiled
def has_turned(s: Record, y: float, reversal_um: float) -> bool:
    """Whether `y` has just come back by more than `reversal_um` from its extreme, which `s` follows."""
    way = y - s["y_extreme"]
    if s["direction"] * way >= 0.0:
        if s["direction"] == 0.0:
            s["direction"] = math.copysign(1.0, way) if way != 0.0 else 0.0
        s["y_extreme"] = y
        return False
    if abs(way) <= reversal_um:
        return False
    s["y_extreme"] = y
    s["direction"] = -s["direction"]
    return True


@compiled.rare
def network_output(p: Record, s: Record, y: float) -> float:
    """Voltage (V) for displacement `y` (um); advances the memory in `s`."""
    if has_turned(s, y, p["reversal_um"]):
        s["y_memory"], s["v_memory"] = s["y_last"], s["v_last"]
    v = p["b_out"]
    for m in range(p["neurons"]):
        activation = (
            p["b_in"][m] + p["w_in"][m, 0] * y + p["w_in"][m, 1] * s["y_memory"] + p["w_in"][m, 2] * s["v_memory"]
        )
        v += p["w_out"][m] * sigmoid(activation)
    s["y_last"], s["v_last"] = y, v
    return v


@compiled.rare
def start_network(s: Record, y: float, v: float) -> None:
    """Memory point at displacement `y` (um) and voltage `v`, as if y had just turned there."""
    s["y_memory"] = s["y_last"] = s["y_extreme"] = y
    s["v_memory"] = s["v_last"] = v
    s["direction"] = 0.0
