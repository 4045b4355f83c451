"""From the validated configuration to the loop's record: physical units become per-sample gains."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from micromanip.bus.driver import Channel
from micromanip.control.gain_schedule import calm_gains, intermittent_gains
from micromanip.control.outer_gains import OuterGains, dc_gain, outer_gains, process_innovation, steady_lag
from micromanip.control.pid import pid_gains
from micromanip.control.tooth import followed_tooth
from micromanip.rt.arming import OF_GAUGE, OF_STAGE
from micromanip.rt.laws.estimator import GAPS, in_blocks
from micromanip.rt.records import CELL_PARAMETERS
from micromanip.rt.states import MODE_NAMES, VOLTAGE
from micromanip.settings.schema.axis import Axis, Outer
from micromanip.settings.schema.hysteresis import NoModel
from micromanip.settings.schema.model import PLAUSIBLE_UM, SWEEP_TURNS, Configuration, Output, Signal, Start
from micromanip.settings.schema.reference import AxisTracker, Jog, Tracker
from micromanip.settings.wiring.places import Wiring
from micromanip.settings.wiring.timing import cycles_between, output_cycles, output_timing, sensor_timing

from .hysteresis import fill_hysteresis, sweep_um
from .limits import NEVER, fill_axis_limits, fill_cell_limits
from .reference import fill_reference

_BLEND_S = 0.05
_FIGURES_S, _TRIAL_S = 1.0, 0.2
"""Over so much are the figures of a tuning averaged, and the error of one on trial."""
_TRIAL_FLOOR_UM = 0.1
"""By so much the error may always grow."""
_gains = functools.lru_cache(8)(outer_gains)
"""Of the axes: a change in one leaves the others."""
_PROCESS_MARGIN = 2.0
"""The model of the stage is not the stage: so many times the mean square that it expects of the process."""
_NOISE_SIGMA, _PLAUSIBLE_SIGMA, _GAP_SAMPLES = 3.0, 5.0, 4
_LONGEST_MEAN_S = 1.0
"""Over more than this the mean of what a contact makes only falls."""

_SCORE_AFTER_S = 1.0
_NEXT_CYCLE = 1
"""The references of a cycle are answered in the next one."""
_ALONE = 0.3
"""Share of its lift in which an axis is ahead of the next one: a sixth of the way."""
_STRAY_S = 0.003
"""Longer than half a period of an inner loop that oscillates, which is another fault."""
_RESET_S = 0.2
"""Long enough for an output that is written ten times a second."""


def compile_cell(configuration: Configuration, wiring: Wiring, version: int = 1) -> Any:
    """Record array (1,) of CELL_PARAMETERS for a configuration that `check` has accepted."""
    record = np.zeros(1, CELL_PARAMETERS)
    p = record[0]
    loop, start = configuration.loop, configuration.start
    period_s = loop.period_ns * 1e-9

    def cycles(seconds: float) -> int:
        return max(1, round(seconds / period_s))

    p["version"], p["axes"], p["period_ns"] = version, len(configuration.axes), loop.period_ns
    p["enable_cycles"] = cycles(start.enable_s) if configuration.switches.amplifier_enable is not None else 0
    closes = any(axis.mode != "voltage" for axis in configuration.axes.values())
    p["check_cycles"] = cycles(start.check_s) if start.check_s is not None and closes else 0
    p["sweep_cycles"], p["sweep_turns"] = round(start.sweep_s / period_s) if closes else 0, SWEEP_TURNS
    p["lift_cycles"], p["settle_cycles"] = cycles(start.lift_s), cycles(start.settle_s)
    p["authority_cycles"], p["ramp_cycles"] = cycles(start.authority_s), cycles(start.ramp_s)
    p["score_cycles"] = cycles(_SCORE_AFTER_S)
    fill_cell_limits(p, configuration.faults, loop.rate_hz)
    _fill_frame(p["frame"], configuration, wiring)
    for name in ("enable", "interlock", "retracted", "part", "tool"):
        _fill_line(p[name], name, configuration, wiring)
    for name in ("amplifier_enable", "amplifier_reset", "feed_hold", "heartbeat"):
        p[name] = wiring.switches.get(name, -1)
    p["reset_cycles"] = cycles(_RESET_S)
    trial = configuration.shadow
    p["figures_step"], p["trial_step"] = 1.0 / cycles(_FIGURES_S), 1.0 / cycles(_TRIAL_S)
    p["trial_cycles"], p["trial_rest"] = cycles(trial.trial_s), cycles(_BLEND_S)
    p["trial_factor"], p["trial_floor"] = trial.error_factor, _TRIAL_FLOOR_UM
    beat = configuration.switches.heartbeat
    p["heartbeat_cycles"] = cycles(beat.period_ms * 0.5e-3) if beat is not None else 1
    for i, (name, axis) in enumerate(configuration.axes.items()):
        _fill_wiring(p["axis"][i], name, configuration, wiring)
        _fill_axis(p["axis"][i], axis, configuration.outputs[f"voltage_{name}"], period_s)
        _fill_checks(p["axis"][i], axis, configuration.outputs[f"voltage_{name}"], start)
        shown, check = _gauge_lag(configuration, wiring, name), p["axis"][i]["check"][OF_GAUGE]
        check["lag_step"], check["slack_cycles"] = 1.0 / shown, cycles(_STRAY_S) + 2 * shown
        p["lift_turn_cycles"] = max(p["lift_turn_cycles"], round(_ALONE * p["lift_cycles"]) + 2 * shown)
        p["axis"][i]["authority_step"] = 1.0 / p["authority_cycles"]
        _fill_decoupling(p["axis"][i]["decoupling"], configuration, name)
        fill_reference(p["axis"][i]["reference"], configuration.reference, i, name, loop.rate_hz)
        _fill_timing(p["axis"][i], name, configuration, wiring)
        if axis.outer is not None:
            tracker = configuration.reference.of(name) if isinstance(configuration.reference, Tracker) else None
            gains = _gains(axis.outer, tracker, period_s)
            _fill_outer(p["axis"][i]["outer"], axis.outer, gains, tracker, period_s)
            _fill_tooth(p["axis"][i]["outer"], axis.outer, gains, period_s)
            _fill_innovation(p["axis"][i], axis, axis.outer, gains, cycles)
    return record


def _fill_timing(a: Any, name: str, configuration: Configuration, wiring: Wiring) -> None:
    """What depends on how often the axis' sensors are fresh, and on the way of its output."""
    axis, loop = configuration.axes[name], configuration.loop
    strain, stage = (sensor_timing(configuration, wiring, role, name) for role in ("strain", "stage"))
    _fill_feedback(a, axis, loop.period_ns * 1e-9, cycles_between(configuration, strain))
    between = cycles_between(configuration, stage)
    tooth_Hz = axis.outer.oscillation_Hz if axis.mode == "stage" and axis.outer is not None else None
    fill_axis_limits(a, axis.faults, configuration.reference, loop.rate_hz, strain.rate_hz, between, tooth_Hz)
    _fill_answer(a, configuration, name, output_timing(configuration, wiring, f"voltage_{name}"))


def _gauge_lag(configuration: Configuration, wiring: Wiring, name: str) -> int:
    """Cycles until the gauge shows a voltage: the output's way, the actuator's lag, the gauge's interval and way."""
    gauge, actuator = sensor_timing(configuration, wiring, "strain", name), configuration.axes[name].undone
    lag_s = gauge.latency_s + 1e-6 * (actuator.delay_us + actuator.gauge_us if actuator is not None else 0.0)
    way = output_cycles(configuration, output_timing(configuration, wiring, f"voltage_{name}"))
    return way + cycles_between(configuration, gauge) + round(lag_s * configuration.loop.rate_hz)


def _fill_feedback(a: Any, axis: Axis, period_s: float, interval: int) -> None:
    for name, value in asdict(pid_gains(axis.running_inner, period_s, interval)).items():
        a["pid"][name] = value
    a["fallback"] = a["pid"]
    for gain in ("K_V_per_um", "integral", "derivative"):
        a["fallback"][gain] = axis.faults.oscillation.fallback * a["pid"][gain]


def _fill_answer(a: Any, configuration: Configuration, name: str, output: Channel) -> None:
    """When the gauge shows a set-point, and how far ahead of it a known reference is followed."""
    axis, period_s = configuration.axes[name], configuration.loop.period_ns * 1e-9
    a["answer_cycles"] = output_cycles(configuration, output)
    actuator = axis.undone
    if actuator is None:
        return
    a["awaited_cycles"] = 1e-6 * (actuator.delay_us + actuator.gauge_us) / period_s
    if not isinstance(configuration.reference, Tracker | Jog):
        a["preview_s"] = a["answer_cycles"] * period_s + 1e-6 * actuator.delay_us


def _max_age_ns(signal: Signal | None) -> int:
    if signal is None or signal.max_age_us is None:
        return NEVER
    return round(signal.max_age_us * 1e3)


def _fill_wiring(a: Any, name: str, configuration: Configuration, wiring: Wiring) -> None:
    for role in ("strain", "stage", "deviation", "true_strain", "true_stage", "path_error", "uncompensated"):
        a[role] = wiring.signal(f"{role}_{name}")
    a["voltage"] = wiring.outputs[f"voltage_{name}"]
    a["strain_age_ns"] = _max_age_ns(configuration.signals.get(f"strain_{name}"))
    a["stage_age_ns"] = _max_age_ns(configuration.signals.get(f"stage_{name}"))
    frame = configuration.frame
    followed = (f"deviation_{name}",) if frame is None else frame.sources
    a["reference_age_ns"] = min(_max_age_ns(configuration.signals.get(each)) for each in followed)
    for role in ("strain", "stage"):
        signal = configuration.signals.get(f"{role}_{name}")
        a[f"{role}_range_um"] = (signal and signal.range_um) or PLAUSIBLE_UM
    a["cycles_per_ns"] = 1.0 / configuration.loop.period_ns
    for role in ("amplifier_ok", "temperature_ok"):
        _fill_line(a[role], f"{role}_{name}", configuration, wiring)


def _fill_frame(f: Any, configuration: Configuration, wiring: Wiring) -> None:
    """How the deviations come of the tracker's own coordinates."""
    frame = configuration.frame
    if frame is None:
        return
    rows, columns = np.shape(frame.whole_matrix)
    f["sources"], f["source"][:columns] = columns, [wiring.signal(name) for name in frame.sources]
    f["derived"], f["first"] = rows, wiring.signal(f"deviation_{next(iter(configuration.axes))}")
    f["matrix"][:rows, :columns] = frame.whole_matrix
    f["offset"][:rows] = frame.offset_um or 0.0


def _fill_line(line: Any, name: str, configuration: Configuration, wiring: Wiring) -> None:
    line["signal"] = wiring.signal(name)
    line["age_ns"] = _max_age_ns(configuration.signals.get(name))


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
    a["authority"] = axis.authority_percent / 100.0
    model = NoModel(model="none") if axis.inner.mode == "pid" else axis.hysteresis
    fill_hysteresis(a["hysteresis"], model, period_s, axis.undone)


def _fill_checks(a: Any, axis: Axis, output: Output, start: Start) -> None:
    """What a small step must do, and how wide the sweep is."""
    (low_um, high_um), (low_V, high_V) = axis.setpoint.range_um, output.range_V
    by_gauge, by_stage = ((high_um - low_um) / (high_V - low_V), start.check_V), (dc_gain(axis.outer), start.check_um)
    for kind, (expected, step) in ((OF_GAUGE, by_gauge), (OF_STAGE, by_stage)):
        check, bounds = a["check"][kind], sorted((expected / start.check_factor, expected * start.check_factor))
        check["step"], check["low"], check["high"], check["slack"] = step, *bounds, step * abs(expected)
    # towards the middle of the range: where it is parked may be an end of it
    a["check"][OF_GAUGE]["step"] *= 1.0 if output.park_V <= 0.5 * (low_V + high_V) else -1.0
    a["sweep_um"] = sweep_um(axis)


def _fill_innovation(a: Any, axis: Axis, outer: Outer, gains: OuterGains, cycles: Callable[[float], int]) -> None:
    """How large the innovation may be: what the filter expects at rest, and what the process brings.

    As a mean square over a while, for the watch; and at once, for the filter.
    """
    said, gain, variance = axis.faults.disagreement, abs(dc_gain(axis.outer)), gains.innovation_variance
    step_um = said.process_um / gain if math.isfinite(gain) and gain > 0.0 else 0.0
    rise, time = cycles(said.process_ms * 1e-3), min(cycles(said.time_ms * 1e-3), cycles(_LONGEST_MEAN_S))
    brought = _PROCESS_MARGIN * process_innovation(outer, gains, step_um, rise, time)
    a["watch"]["innovation_variance"] = variance
    a["watch"]["drift_gain"] = dc_gain(axis.outer)
    if not math.isfinite(gain):
        a["watch"]["drift_gain"], a["watch"]["drift_um"] = 0.0, math.inf
    a["watch"]["innovation_ratio"] += brought / variance
    a["outer"]["repeated_um"] = _NOISE_SIGMA * math.sqrt(variance)
    a["outer"]["innovation_um"] = math.sqrt(_PLAUSIBLE_SIGMA**2 * variance + brought)


def _fill_outer(o: Any, outer: Outer, gains: OuterGains, tracker: AxisTracker | None, period_s: float) -> None:
    n = len(gains.A)
    o["states"], o["slow"] = n, len(outer.model.A) + outer.model.delay_cycles
    o["gap_cycles"] = _GAP_SAMPLES * outer.sample_cycles
    o["a_blocks"], o["b"][:n], o["c"][:n] = in_blocks(gains.A), gains.B, gains.C
    o["gains"][:, :n], o["reference_states"] = intermittent_gains(gains, GAPS), len(gains.reference)
    for name in vars(gains).keys() & o.dtype.names:
        value = getattr(gains, name)
        o[name] = np.pad(value, (0, len(o[name]) - len(value))) if np.ndim(value) else value
    far, following = calm_gains(outer, gains, tracker, period_s)
    o["far_feedback"][:n], o["far_reference"][: len(following)] = far, following


def _fill_tooth(o: Any, outer: Outer, gains: OuterGains, period_s: float) -> None:
    """What the estimator needs where it follows the tooth's frequency; all 0 where it does not."""
    if not outer.follows_tooth:
        return
    found = followed_tooth(outer, gains, GAPS, period_s)
    o["tooth"], o["plain"][:, : len(gains.A)] = found.place, found.plain
    for name in ("share", "turn", "range", "slew", "floor_um2", "shown", "window", "patience", "fade"):
        o[f"tooth_{name}"] = getattr(found, name)


def _fill_decoupling(d: Any, configuration: Configuration, name: str) -> None:
    """What axis `name` adds to its set-point for the references of the others: shares of the set-point, and its lead.

    `d` is a DECOUPLING_PARAMETERS record; between axes in mode stage, where that is asked for.
    """
    axis = configuration.axes[name]
    if axis.coupling is None or not axis.coupling.decouple or axis.mode != "stage" or axis.outer is None:
        return
    gain, period_s = dc_gain(axis.outer), configuration.loop.period_ns * 1e-9
    d["lead_s"] = (steady_lag(axis.outer) + _NEXT_CYCLE) * period_s
    for j, (other, settings) in enumerate(configuration.axes.items()):
        if settings.mode == "stage":
            d["share"][j] = axis.coupling.share.get(other, 0.0) / gain
    d["active"] = int(d["share"].any())
