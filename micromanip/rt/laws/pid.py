"""PID on the strain gauge, equation (17), with filtered derivative and back-calculation.

``u = K [e + 1/Ti int e + Td de/dt]``, e in um behind the notch (``resonance.py``), u in V. The integrator is kept in V,
so that a change of Ti is bumpless by itself; ``retune`` covers one of K or of the notch. The derivative passes a
first-order filter of time constant Tf (backward Euler, stable for every Tf >= 0 and period).
``tracking`` is period/Tt of the back-calculation, stable for 0 <= tracking < 2.

A step covers `periods` cycles, normally one: with a slow sensor the cycles since its last sample. Periods that an
overrun skipped, or in which the sensor was unusable, do not count: the error after them did not last all the time, and
its integral over them would kick the output. If samples are missing, the integral takes at most `most_periods` per
step, twice the sensor's interval: a gain margin of 6 dB allows that, but not ten times the gain (decision 0072). A held
sample is never integrated or differentiated: the caller does not step then.
"""

from __future__ import annotations

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

from .resonance import NOTCH, NOTCH_STATE, is_same_notch, notch_output, start_notch

PID_PARAMETERS = record(
    ("K_V_per_um", "f8"),
    ("integral", "f8"),
    ("derivative", "f8"),
    ("filter_s", "f8"),
    ("period_s", "f8"),
    ("tracking", "f8"),
    ("most_periods", "i8"),
    *NOTCH,
)
PID_STATE = record(("integrator", "f8"), ("derivative", "f8"), ("error", "f8"), ("output_V", "f8"), *NOTCH_STATE)
"""``error``: what the PID acted on last, behind the notch."""


@compiled
def pid_output(p: Record, s: Record, error_um: float, periods: int) -> float:
    """Feedback voltage (V) for `error_um`, `periods` cycles after the step before."""
    error_um = notch_output(p, s, error_um, periods)
    elapsed_s = periods * p["period_s"]
    s["derivative"] = (p["filter_s"] * s["derivative"] + p["derivative"] * (error_um - s["error"])) / (
        p["filter_s"] + elapsed_s
    )
    s["integrator"] += p["integral"] * min(periods, p["most_periods"]) * error_um
    s["error"] = error_um
    s["output_V"] = p["K_V_per_um"] * error_um + s["integrator"] + s["derivative"]
    return s["output_V"]


@compiled
def unwind(p: Record, s: Record, excess_V: float) -> None:
    """Back-calculation in every cycle: `excess_V` is requested minus applied voltage.

    The output held until the next sample is reduced as well: otherwise a slow sensor's integrator would be unwound by
    the same excess again and again, and overshoot.
    """
    s["integrator"] -= p["tracking"] * excess_V
    s["output_V"] -= p["tracking"] * excess_V


@compiled
def start_pid(p: Record, s: Record, error_um: float, output_V: float) -> None:
    """Bumpless start: the next step at the same error continues from `output_V`."""
    start_notch(p, s, error_um)
    s["derivative"] = 0.0
    s["error"] = error_um
    s["integrator"] = output_V - p["K_V_per_um"] * error_um
    s["output_V"] = output_V


@compiled
def retune(old: Record, new: Record, s: Record) -> None:
    """Bumpless change of parameters: the output of the last step is what `new` would have given."""
    s["integrator"] += (old["K_V_per_um"] - new["K_V_per_um"]) * s["error"]
    if not is_same_notch(old, new):
        s["integrator"] -= new["K_V_per_um"] * s["notch_um"]
        s["error"] += s["notch_um"]
        start_notch(new, s, s["error"])
    if old["derivative"] != new["derivative"] or old["filter_s"] != new["filter_s"]:
        s["integrator"] += s["derivative"]
        s["derivative"] = 0.0
