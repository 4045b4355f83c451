"""Recurrent-network inverse of the hysteresis, equations (10)-(12), displacement to voltage.

Input ``X = [y_k, y_{k-1}, v_{k-1}]``, one hidden layer of sigmoid neurons, output ``v_k`` (section
3.4: y as the input, v as the output). Weights are in physical units (um, V): the scaling used in
training is folded into them.

The memory ``(y_{k-1}, v_{k-1})`` moves on every ``stride`` cycles, the sampling of the training
record, while the output follows the displacement in every cycle: what the network has learnt is
the branch that leaves the memory point, and a rate-independent branch is a function of y alone.
"""

from __future__ import annotations

import math

from .jit import compiled
from .records import Record


@compiled
def sigmoid(x: float) -> float:
    """Activation of (11), ``1/(1 + exp(-x))``; finite for any finite `x`."""
    return 1.0 / (1.0 + math.exp(-x)) if x > -700.0 else 0.0


@compiled
def network_output(p: Record, s: Record, y: float) -> float:
    """Voltage (V) for displacement `y` (um); advances the memory in `s`."""
    v = p["b_out"]
    for m in range(p["neurons"]):
        activation = (
            p["b_in"][m] + p["w_in"][m, 0] * y + p["w_in"][m, 1] * s["y_memory"] + p["w_in"][m, 2] * s["v_memory"]
        )
        v += p["w_out"][m] * sigmoid(activation)
    s["count"] += 1
    if s["count"] >= p["stride"]:
        s["count"] = 0
        s["y_memory"] = y
        s["v_memory"] = v
    return v
