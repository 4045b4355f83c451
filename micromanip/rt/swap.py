"""Bumpless change of all parameters at a cycle boundary: every state kept, no output jumps.

The PID's integrator takes up what another gain or another inverse model would have changed, and
the outer loop's set-point is blended over from where it is.
"""

from __future__ import annotations

from .feedforward import feedforward_voltage, start_feedforward
from .jit import compiled
from .pid import retune
from .records import Record


@compiled
def _outer_differs(old: Record, new: Record) -> bool:
    if old["states"] != new["states"]:
        return True
    for i in range(new["states"]):
        if old["b"][i] != new["b"][i] or old["c"][i] != new["c"][i] or old["gain"][i] != new["gain"][i]:
            return True
        for j in range(new["states"]):
            if old["a"][i, j] != new["a"][i, j]:
                return True
    return False


@compiled
def swap_axis(old: Record, new: Record, s: Record) -> None:
    """Carry the state `s` of one axis over from parameters `old` to `new`."""
    retune(old["pid"], new["pid"], s["pid"])
    before = s["hysteresis"]["output_V"]
    start_feedforward(new["hysteresis"], s["hysteresis"], s["setpoint_um"], s["voltage_V"])
    after = feedforward_voltage(new["hysteresis"], s["hysteresis"], s["setpoint_um"])
    s["pid"]["integrator"] += before - after
    s["pid"]["output_V"] += before - after
    if _outer_differs(old["outer"], new["outer"]):
        s["estimator"]["running"] = 0
    s["closed"] = 0


@compiled
def swap_cell(old: Record, new: Record, s: Record) -> None:
    """Carry the whole cell over; the caller uses `new` from this cycle on."""
    for i in range(new["axes"]):
        swap_axis(old["axis"][i], new["axis"][i], s["axis"][i])
    s["version"] = new["version"]
