"""Start and change of all laws of an axis, in one place: no output jumps, and every state that still counts is kept.

At a start every memory agrees with the present voltage and position. Under new parameters, at a cycle boundary, the
PID's integrator takes up what another gain or another inverse model would have changed, and the outer loop's set-point
is led over from where it is. A shadow begins as a copy that is changed to the candidate's parameters.
"""

from __future__ import annotations

from micromanip.rt.laws.estimator import change_model
from micromanip.rt.laws.feedforward import feedforward_voltage, start_feedforward
from micromanip.rt.laws.learned import forget_played
from micromanip.rt.laws.pid import retune, start_pid
from micromanip.rt.laws.reference import change_modes

from .arming import carry_checks
from .jit import compiled
from .record import Record
from .reference_blend import start_blend
from .setpoint_history import start_history
from .states import STAGE, VOLTAGE
from .supervisor import gains_of, start_supervisor


@compiled.rare
def start_axis(p: Record, s: Record) -> None:
    """Take the output over where it is."""
    start_um = s["voltage_V"] if p["mode"] == VOLTAGE else s["strain"]["value"]
    s["estimator"]["running"] = 0
    forget_played(s["learned"])
    start_supervisor(s["supervisor"])
    s["reference"]["jog_um"], s["reference"]["jog_step_um"] = p["reference"]["target_um"], 0.0
    start_blend(p, s["blend"], start_um)
    s["setpoint_um"] = start_um
    start_history(p, s)
    start_feedforward(p["hysteresis"], s["hysteresis"], start_um, s["voltage_V"])
    feedforward = feedforward_voltage(p["hysteresis"], s["hysteresis"], start_um)
    start_pid(p["pid"], s["pid"], 0.0, s["voltage_V"] - feedforward)


@compiled
def change_axis(old: Record, new: Record, s: Record) -> None:
    """Carry the state `s` of one axis over from parameters `old` to `new`."""
    if old["feedback"] == 0 and new["feedback"] != 0:
        start_pid(new["pid"], s["pid"], s["strain_error_um"], s["pid"]["output_V"])
    else:
        retune(gains_of(old, s["supervisor"]["gain_set"]), new["pid"], s["pid"])
    if old["hysteresis"]["identity"] != new["hysteresis"]["identity"]:
        before = s["hysteresis"]["output_V"]
        start_feedforward(new["hysteresis"], s["hysteresis"], s["setpoint_um"], s["voltage_V"])
        after = feedforward_voltage(new["hysteresis"], s["hysteresis"], s["setpoint_um"])
        s["pid"]["integrator"] += before - after
        s["pid"]["output_V"] += before - after
    change_model(old["outer"], new["outer"], s["estimator"])
    change_modes(old["reference"], new["reference"], s["reference"])
    if new["mode"] != STAGE:
        s["estimator"]["running"] = 0
    s["supervisor"]["gain_set"] = 0
    s["blend"]["held_since"] = -1


@compiled.rare
def swap_cell(old: Record, new: Record, s: Record) -> None:
    """Carry the whole cell over; the caller uses `new` from this cycle on."""
    for i in range(new["axes"]):
        change_axis(old["axis"][i], new["axis"][i], s["axis"][i])
        carry_checks(old["axis"][i], new["axis"][i], s["arming"][i])
        s["watch"][i]["fallback"] = s["watch"][i]["band_cycles"] = 0
    s["version"] = new["version"]
