"""Bumpless change of all parameters at a cycle boundary: every state kept, no output jumps.

The PID's integrator takes up what another gain or another inverse model would have changed, and
the outer loop's set-point is blended over from where it is.
"""

from __future__ import annotations

from micromanip.rt.laws.estimator import change_model
from micromanip.rt.laws.feedforward import feedforward_voltage, start_feedforward
from micromanip.rt.laws.pid import retune, start_pid
from micromanip.rt.laws.reference import change_modes

from .arming import carry_checks
from .jit import compiled
from .record import Record
from .states import STAGE


@compiled
def swap_axis(old: Record, new: Record, s: Record) -> None:
    """Carry the state `s` of one axis over from parameters `old` to `new`."""
    if old["feedback"] == 0 and new["feedback"] != 0:
        start_pid(new["pid"], s["pid"], s["strain_error_um"], s["pid"]["output_V"])
        s["strain_cycles"] = 0
    else:
        retune(old["fallback"] if s["calm"] else old["pid"], new["pid"], s["pid"])
    if old["hysteresis"]["identity"] != new["hysteresis"]["identity"]:
        before = s["hysteresis"]["output_V"]
        start_feedforward(new["hysteresis"], s["hysteresis"], s["setpoint_um"], s["voltage_V"])
        after = feedforward_voltage(new["hysteresis"], s["hysteresis"], s["setpoint_um"])
        s["pid"]["integrator"] += before - after
        s["pid"]["output_V"] += before - after
    carry_checks(old, new, s)
    change_model(old["outer"], new["outer"], s["estimator"])
    change_modes(old["reference"], new["reference"], s["reference"])
    if new["mode"] != STAGE:
        s["estimator"]["running"] = 0
    s["watch"]["fallback"] = s["watch"]["band_cycles"] = s["calm"] = 0
    s["closed"] = 0


@compiled.rare
def swap_cell(old: Record, new: Record, s: Record) -> None:
    """Carry the whole cell over; the caller uses `new` from this cycle on."""
    for i in range(new["axes"]):
        swap_axis(old["axis"][i], new["axis"][i], s["axis"][i])
    s["version"] = new["version"]
