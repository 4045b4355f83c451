"""Bumpless change of all parameters at a cycle boundary: every state kept, no output jumps.

The PID's integrator takes up what another gain or another inverse model would have changed, and
the outer loop's set-point is blended over from where it is.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.laws.feedforward import feedforward_voltage, start_feedforward
from micromanip.rt.laws.pid import retune, start_pid

from .arming import carry_checks
from .jit import compiled
from .records import MAX_STATES, Record
from .states import STAGE


@compiled
def _differ(old: Any, new: Any, count: int) -> bool:
    for i in range(count):  # noqa: SIM110 (a generator is not for compiled code)
        if old[i] != new[i]:
            return True
    return False


@compiled
def _inverse_differs(old: Record, new: Record) -> bool:
    for i in range(new["neurons"]):
        if _differ(old["w_in"][i], new["w_in"][i], 3):
            return True
    a, b = old["shaping"], new["shaping"]
    return (
        old["kind"] != new["kind"]
        or old["plays"] != new["plays"]
        or old["alpha"] != new["alpha"]
        or old["rate_cycles"] != new["rate_cycles"]
        or old["creeps"] != new["creeps"]
        or old["low_um"] != new["low_um"]
        or old["high_um"] != new["high_um"]
        or old["neurons"] != new["neurons"]
        or old["reversal_um"] != new["reversal_um"]
        or old["b_out"] != new["b_out"]
        or a["kind"] != b["kind"]
        or a["points"] != b["points"]
        or _differ(a["c"], b["c"], 4)
        or _differ(a["v"], b["v"], b["points"])
        or _differ(a["u"], b["u"], b["points"])
        or _differ(old["r"], new["r"], new["plays"])
        or _differ(old["rho"], new["rho"], new["plays"])
        or _differ(old["creep_gain"], new["creep_gain"], new["creeps"])
        or _differ(old["creep_step"], new["creep_step"], new["creeps"])
        or _differ(old["b_in"], new["b_in"], new["neurons"])
        or _differ(old["w_out"], new["w_out"], new["neurons"])
    )


@compiled
def _swap_estimate(old: Record, new: Record, s: Record) -> None:
    """Keep the estimate, whatever the gains, where one model is the other plus disturbances; else it starts anew."""
    n = min(old["states"], new["states"])
    differs = _differ(old["b"], new["b"], n) or _differ(old["c"], new["c"], n)
    for i in range(n):
        differs = differs or _differ(old["a_columns"][i], new["a_columns"][i], n)
    if differs:
        s["running"] = 0
    for i in range(n, MAX_STATES):
        s["x"][i] = s["filtered"][i] = 0.0


@compiled
def swap_axis(old: Record, new: Record, s: Record) -> None:
    """Carry the state `s` of one axis over from parameters `old` to `new`."""
    if old["feedback"] == 0 and new["feedback"] != 0:
        start_pid(new["pid"], s["pid"], s["strain_error_um"], s["pid"]["output_V"])
        s["strain_cycles"] = 0
    else:
        retune(old["fallback"] if s["watch"]["fallback"] else old["pid"], new["pid"], s["pid"])
    if _inverse_differs(old["hysteresis"], new["hysteresis"]):
        before = s["hysteresis"]["output_V"]
        start_feedforward(new["hysteresis"], s["hysteresis"], s["setpoint_um"], s["voltage_V"])
        after = feedforward_voltage(new["hysteresis"], s["hysteresis"], s["setpoint_um"])
        s["pid"]["integrator"] += before - after
        s["pid"]["output_V"] += before - after
    carry_checks(old, new, s)
    _swap_estimate(old["outer"], new["outer"], s["estimator"])
    if new["mode"] != STAGE:
        s["estimator"]["running"] = 0
    s["watch"]["fallback"] = s["watch"]["band_cycles"] = 0
    s["closed"] = 0


@compiled
def swap_cell(old: Record, new: Record, s: Record) -> None:
    """Carry the whole cell over; the caller uses `new` from this cycle on."""
    for i in range(new["axes"]):
        swap_axis(old["axis"][i], new["axis"][i], s["axis"][i])
    s["version"] = new["version"]
