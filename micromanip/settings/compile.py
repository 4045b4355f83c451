"""From the validated configuration to the loop's record: physical units become gains a sample."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.rt import hysteresis as rt_hysteresis
from micromanip.rt import reference as rt_reference
from micromanip.rt import shaping as rt_shaping
from micromanip.rt.records import CELL_PARAMETERS
from micromanip.rt.states import MODE_NAMES, VOLTAGE

from .axis import Axis
from .hysteresis import Hysteresis, Network, NoModel, PrandtlIshlinskii
from .model import Configuration, Output, Signal
from .outer import OuterGains, outer_gains, tracker_gain
from .reference import File, Hold, Reference, Sines, Step, Tracker
from .wiring import Wiring

_NO_LIMIT = np.iinfo(np.int64).max // 4
_BLEND_S = 0.05
_PLAUSIBLE_UM = (-1000.0, 1000.0)

HEARTBEAT_LIMIT_S = {"hardware": 0.1, "simulation": 1.0}
OVERRUN_LIMIT = {"hardware": 3, "simulation": None}
_BAD_SAMPLES = 3
_SCORE_AFTER_S = 1.0


def compile_cell(configuration: Configuration, wiring: Wiring, version: int = 1) -> Any:
    """Record array (1,) of CELL_PARAMETERS for a configuration that `check` has accepted."""
    record = np.zeros(1, CELL_PARAMETERS)
    p = record[0]
    loop, start = configuration.loop, configuration.start
    period_s = loop.period_ns * 1e-9

    def cycles(seconds: float) -> int:
        return max(1, round(seconds / period_s))

    p["version"], p["axes"], p["period_ns"] = version, len(configuration.axes), loop.period_ns
    p["lift_cycles"], p["settle_cycles"] = cycles(start.lift_s), cycles(start.settle_s)
    p["authority_cycles"], p["ramp_cycles"] = cycles(start.authority_s), cycles(start.ramp_s)
    p["score_cycles"] = cycles(_SCORE_AFTER_S)
    p["heartbeat_ns"] = round(HEARTBEAT_LIMIT_S[loop.limits] * 1e9)
    overruns = OVERRUN_LIMIT[loop.limits]
    p["overruns_in_a_row"] = _NO_LIMIT if overruns is None else overruns
    p["bad_samples"] = _BAD_SAMPLES
    for i, (name, axis) in enumerate(configuration.axes.items()):
        _fill_wiring(p["axis"][i], name, configuration, wiring)
        _fill_axis(p["axis"][i], axis, configuration.outputs[f"voltage_{name}"], period_s)
        _fill_reference(p["axis"][i]["reference"], configuration.reference, i, loop.rate_hz)
        if axis.outer is not None:
            tracker = configuration.reference if isinstance(configuration.reference, Tracker) else None
            _fill_outer(p["axis"][i]["outer"], outer_gains(axis.outer, tracker, period_s))
    return record


def _max_age_ns(signal: Signal | None) -> int:
    if signal is None or signal.max_age_us is None:
        return int(_NO_LIMIT)
    return round(signal.max_age_us * 1e3)


def _fill_wiring(a: Any, name: str, configuration: Configuration, wiring: Wiring) -> None:
    for role in ("strain", "stage", "deviation", "true_strain", "true_stage", "path_error", "uncompensated"):
        a[role] = wiring.signal(f"{role}_{name}")
    a["voltage"] = wiring.outputs[f"voltage_{name}"]
    a["strain_age_ns"] = _max_age_ns(configuration.signals.get(f"strain_{name}"))
    a["stage_age_ns"] = _max_age_ns(configuration.signals.get(f"stage_{name}"))
    a["reference_age_ns"] = _max_age_ns(configuration.signals.get(f"deviation_{name}"))
    for role in ("strain", "stage"):
        signal = configuration.signals.get(f"{role}_{name}")
        a[f"{role}_range_um"] = (signal and signal.range_um) or _PLAUSIBLE_UM
    a["stage_cycles_per_ns"] = 1.0 / configuration.loop.period_ns


def _fill_axis(a: Any, axis: Axis, output: Output, period_s: float) -> None:
    a["mode"] = MODE_NAMES.index(axis.mode)
    a["centre_um"] = axis.centre_um
    a["setpoint_low_um"], a["setpoint_high_um"] = axis.setpoint.range_um
    a["setpoint_slew_um"] = axis.setpoint.slew_um_per_ms * 1e3 * period_s
    if a["mode"] == VOLTAGE:
        a["setpoint_low_um"], a["setpoint_high_um"] = output.range_V
        a["setpoint_slew_um"] = output.slew_V_per_ms * 1e3 * period_s
    a["blend_decay"] = math.exp(-period_s / _BLEND_S)
    a["feedback"] = axis.inner.mode != "feedforward"
    limiter = a["limiter"]
    limiter["low_V"], limiter["high_V"] = output.range_V
    limiter["slew_V"], limiter["park_V"] = output.slew_V_per_ms * 1e3 * period_s, output.park_V
    inner, pid = axis.inner, a["pid"]
    pid["gain"], pid["period_s"] = inner.K_V_per_um, period_s
    pid["integral"] = inner.K_V_per_um * period_s / (inner.Ti_ms * 1e-3)
    pid["derivative"] = inner.K_V_per_um * inner.Td_ms * 1e-3
    pid["filter_s"] = inner.filter_ms * 1e-3
    pid["tracking"] = min(1.0, period_s / (inner.tracking_ms * 1e-3))
    fill_hysteresis(a["hysteresis"], NoModel(model="none") if inner.mode == "pid" else axis.hysteresis, period_s)


def fill_hysteresis(h: Any, model: Hysteresis, period_s: float) -> None:
    """Fill a HYSTERESIS_PARAMETERS record from `model`."""
    h["kind"] = rt_hysteresis.NONE
    if isinstance(model, NoModel):
        return
    h["low_um"], h["high_um"] = model.range_um
    if isinstance(model, Network):
        n = len(model.input_weights)
        h["kind"], h["neurons"] = rt_hysteresis.NETWORK, n
        h["reversal_um"] = model.reversal_um
        h["w_in"][:n], h["b_in"][:n] = model.input_weights, model.input_biases
        h["w_out"][:n], h["b_out"] = model.output_weights, model.output_bias
        return
    fill_prandtl_ishlinskii(h, model, period_s)


def fill_prandtl_ishlinskii(h: Any, model: PrandtlIshlinskii, period_s: float) -> None:
    """Fill model and inverse (8)-(9), creep and rate dependence a step of `period_s`."""
    n = len(model.thresholds_um)
    h["kind"], h["plays"], h["alpha"] = rt_hysteresis.PRANDTL_ISHLINSKII, n, model.alpha
    h["r"][:n], h["rho"][:n] = model.thresholds_um, model.weights
    shaping = h["shaping"]
    shaping["kind"] = {
        "identity": rt_shaping.IDENTITY,
        "affine": rt_shaping.AFFINE,
        "tanh": rt_shaping.TANH,
        "table": rt_shaping.TABLE,
    }[model.shaping]
    shaping["c"][: len(model.coefficients)] = model.coefficients
    points = len(model.table_V)
    shaping["points"] = points
    shaping["v"][:points], shaping["u"][:points] = model.table_V, model.table_um
    h["rate_cycles"] = model.rate_ms * 1e-3 / period_s
    creeps = len(model.creep_s)
    h["creeps"] = creeps
    h["creep_gain"][:creeps] = model.creep_gains
    h["creep_step"][:creeps] = -np.expm1(-period_s / np.array(model.creep_s, dtype=float))
    rt_hysteresis.inverse_parameters(h)


def _fill_reference(r: Any, reference: Reference, column: int, rate_hz: int) -> None:
    r["oscillator"] = 2 * math.pi
    if isinstance(reference, Tracker):
        r["kind"], r["predict"] = rt_reference.SIGNAL, reference.predict
        r["oscillator"] = 2 * math.pi * reference.oscillation_Hz
        r["gain"] = tracker_gain(reference)
        r["horizon_s"] = reference.horizon_ms * 1e-3
        r["low_um"], r["high_um"] = reference.range_um
        return
    if isinstance(reference, File):
        r["kind"], r["column"], r["samples_per_s"] = rt_reference.SAMPLES, column, rate_hz
        return
    r["offset_um"], r["start_s"] = reference.offset_um, reference.start_s
    if isinstance(reference, Hold):
        r["kind"] = rt_reference.HOLD
    elif isinstance(reference, Step):
        r["kind"], r["step_um"] = rt_reference.STEP, reference.step_um
    elif isinstance(reference, Sines):
        r["kind"], r["sines"] = rt_reference.SINES, len(reference.sines)
        for k, sine in enumerate(reference.sines):
            r["amplitude_um"][k] = sine.amplitude_um
            r["omega"][k] = 2 * math.pi * sine.frequency_Hz
            r["phase"][k] = math.radians(sine.phase_deg)


def _fill_outer(o: Any, gains: OuterGains) -> None:
    n = len(gains.A)
    o["states"] = n
    o["a_columns"][:n, :n], o["b"][:n], o["c"][:n] = gains.A.T, gains.B, gains.C
    o["gain"][:n], o["feedback"][:n], o["reference"] = gains.observer, gains.feedback, gains.reference
    o["steady_u"][:n], o["steady_y"][:n] = gains.steady_u, gains.steady_y
