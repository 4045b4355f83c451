"""Feedforward of one axis: the voltage at which the hysteresis model gives the set-point.

The set-point is clipped to the attainable range *before* the inverse: clipping the voltage after
it would let the memories of the model and of the actuator drift apart.
"""

from __future__ import annotations

from .hysteresis import NETWORK, PRANDTL_ISHLINSKII, admit, inverse_output
from .jit import compiled
from .network import network_output
from .records import Record


@compiled
def feedforward_voltage(p: Record, s: Record, setpoint_um: float) -> float:
    """Voltage (V) for `setpoint_um`; 0 without a model (pure feedback, configuration A)."""
    y = max(p["low_um"], min(p["high_um"], setpoint_um))
    v = 0.0
    if p["kind"] == PRANDTL_ISHLINSKII:
        v = inverse_output(p, s["z"], y)
    elif p["kind"] == NETWORK:
        v = network_output(p, s, y)
    s["output_V"] = v
    return v


@compiled
def start_feedforward(p: Record, s: Record, y_um: float, v: float) -> None:
    """Take over at displacement `y_um` and voltage `v`: memory made consistent, whatever it was."""
    y = max(p["low_um"], min(p["high_um"], y_um))
    admit(p, s["z"], y)
    s["y_memory"] = y
    s["v_memory"] = v
    s["count"] = 0
