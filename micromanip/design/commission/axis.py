"""One axis from factory values to a tuning: move, excite, judge, model, synthesise, validate. Nothing is applied.

Every step works on the configuration that the step before has made; what goes wrong raises CheckFailed, with what was
seen and what to do, before a loop is closed that should not be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import outer_gains
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE

from ..actuation import DELAYS, ORDERS, Actuator, identify_actuator
from ..closed import measure_outer_loop, measure_strain_loop
from ..experiment import Experiment, with_axis
from ..hysteresis import HysteresisFit
from ..identification import design, recording, samples_for, variant
from ..judged import analyse_inverse, analyse_strain, slopes_of
from ..loops import over_path, stage_loop, strain_loop
from ..record import Record, judge_record
from ..response import Wanted, identify
from ..sensitivity import Sensitivity, judge_loop
from ..synthesis import OuterDesign, PidDesign, Reach, Undone, tune_outer, tune_pid, undo
from ..tuning import StageModel, burn_in, hysteresis_models, identify_stage, record_hysteresis, with_response
from .at_rest import tooth_at_work
from .borne import DRAWN, Borne
from .partial import Steps
from .polarity import Polarity, check_polarity
from .quality import HELD_OUT_PERCENT, Quality, judge_coverage
from .rest import check_rest
from .travel import check_answer, check_travel
from .validation import Validation, validate
from .watched import Watched

Array = NDArray[np.float64]
Say = Callable[[str], None]

BUS_SLOPE = 1.45
"""The PID holds its margins up to this multiple of the actuator's slope where the samples of a bus show less of it."""
TRIANGLE_S = 12.0


@dataclass(frozen=True)
class Knobs:
    """What a human may ask for; None leaves it to the margins and to what was measured."""

    bandwidth_Hz: float | None = None
    noise_um: float | None = None
    tooth_Hz: float | None = None
    """Tooth-passing frequency that the outer loop cancels; None leaves it to the axis' own section `outer`."""
    tooth_seen_Hz: float | None = None
    """The one that was seen, for an axis without that section; None: nothing is cancelled, unless it sees one."""


@dataclass(frozen=True)
class Commissioned:
    """Everything that was found about one axis; `configuration` holds its new tuning."""

    axis: str
    configuration: Configuration
    polarity: Polarity
    triangle: dict[str, Array]
    record: dict[str, Array]
    held_out: dict[str, Array]
    quality: Quality
    tanh: HysteresisFit
    affine: HysteresisFit
    held_out_percent: dict[str, float]
    actuator: Actuator
    pid: PidDesign
    strain_loop: Sensitivity
    stage: StageModel
    outer: OuterDesign
    outer_loop: Sensitivity
    validation: Validation
    undone: Undone | None = None
    """What the feedforward of mode strain undoes; None where the configuration does not say how late the gauge is."""
    learned: tuple[str, ...] = ()
    """What was measured, found wanting and done again, in sentences."""
    tooth_Hz: float | None = None
    """Tooth-passing frequency that was seen while the axis stood where it works; None: not looked for, or none."""


def commission_axis(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    say: Say,
    knobs: Knobs | None = None,
    seed: int = 1,
    running: Experiment | None = None,
) -> Commissioned:
    """All steps for one axis; raises Stopped, with what was found by then, where one of them says no.

    In `running` the process goes on: a tooth that nobody has told or seen is looked for in it.
    """
    steps = Steps(axis, say)
    with steps.kept():
        return _commission(configuration, experiment, axis, steps, knobs or Knobs(), seed, running)


def _commission(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    steps: Steps,
    knobs: Knobs,
    seed: int,
    running: Experiment | None,
) -> Commissioned:
    settings, say = configuration.axes[axis], steps.begin
    configuration = with_axis(configuration, axis, actuator=None)  # that of another tuning
    say("sensors at rest")
    check_rest(configuration, experiment, axis)
    say("polarity and scale")
    polarity = check_polarity(configuration, experiment, axis)
    steps.learn(
        slope=f"{polarity.slope_um_per_V:.3f} um/V",
        noise_of_the_gauge_at_rest=f"{polarity.noise_um:.3f} um rms",
    )
    say("major loop")
    triangle, others_um = _triangle(configuration, experiment, axis)
    judge_coverage(axis, triangle["voltage_V"], triangle["strain_um"], settings.setpoint.range_um)
    steps.learn(stage_over_gauge=f"{check_travel(configuration, axis, triangle, others_um):.2f}")
    say("answer to a step")
    answer = check_answer(configuration, experiment, axis, _holding_voltage(triangle, settings.centre_um))
    steps.learn(gauge_after_a_step=f"63 % in {answer.rise_ms:.1f} ms")
    say("excitation")
    record, held_out = (record_hysteresis(configuration, experiment, axis, each) for each in (seed, seed + 1))
    judge_record(_as_record(axis, record))
    quality = judge_coverage(axis, record["voltage_V"], record["strain_um"], settings.setpoint.range_um)
    steps.learn(
        stroke=f"{np.ptp(record['strain_um']):.0f} um", coverage=f"{100 * quality.coverage:.0f} % of the set-points"
    )
    say("hysteresis models")
    tanh, affine = hysteresis_models(record, settings.setpoint.range_um)
    percent = {
        fitted.structure.name: fitted.held_out(held_out["voltage_V"], held_out["strain_um"], burn_in(held_out))[0]
        for fitted in (tanh, affine)
    }
    steps.learn(hysteresis_on_unseen_data=f"{min(percent.values()):.2f} % of the stroke")
    if min(percent.values()) > HELD_OUT_PERCENT:
        raise CheckFailed(
            f"axis {axis}: no hysteresis model predicts the second record better than to {min(percent.values()):.1f} % "
            f"of the stroke, {HELD_OUT_PERCENT:g} % are needed: look for slip, a loose gauge or a disturbance meanwhile"
            f"{answer.slow(max(settings.accept.frequencies_Hz))}"
        )
    tuned = with_axis(configuration, axis, hysteresis=tanh.model, hysteresis_affine=affine.model)
    say("actuator")
    actuator = identify_actuator(configuration, experiment, axis, seed, _holding_voltage(record, settings.centre_um))
    learned: list[str] = []
    steps.learn(
        actuator=f"order {actuator.found.order}, delay {actuator.delay} cycles, fit {actuator.fit_percent:.1f} % about "
        f"{actuator.centre_V:.0f} V"
    )
    say("strain PID")
    left_um = 0.01 * min(percent.values()) * tanh.stroke_um
    actuator, pid, strain_closed = _close_strain(
        tuned, experiment, axis, actuator, polarity, left_um, seed, say, learned
    )
    tuned = with_axis(tuned, axis, inner=pid.inner)
    steps.learn(
        strain_PID=f"K {pid.inner.K_V_per_um:g} V/um, Ti {pid.inner.Ti_ms:g} ms, Td {pid.inner.Td_ms:g} ms, filter "
        f"{pid.inner.filter_ms:g} ms; {pid.limited_by}",
        strain_loop=strain_closed.sentence,
    )
    tooth = None
    if running is not None and settings.outer is None and _tooth_Hz(knobs, settings) is None:
        say("tooth where it works")
        try:
            tooth = tooth_at_work(tuned, running, axis)
        except CheckFailed as problem:  # of the process alone: without it the axis can still be tuned
            learned.append(f"with the process, where it works: {problem}")
        if tooth is not None:
            knobs = replace(knobs, tooth_seen_Hz=tooth[0])
            steps.learn(tooth_where_it_works=f"{tooth[1]:.2f} um at {tooth[0]:g} Hz")
    say("stage dynamics")
    stage = identify_stage(tuned, experiment, axis, seed)
    stage, outer, outer_loop = _close_outer(tuned, experiment, axis, actuator, stage, knobs, seed, say, learned)
    say("validation")
    tuned = with_axis(tuned, axis, outer=outer.outer)
    validation = validate(tuned, experiment, axis)
    undone, kept = None, settings.actuator
    if kept is not None and actuator.path == AT_ONCE:
        asked_Hz = settings.accept.frequencies_Hz
        model = actuator.dynamics, actuator.delay
        undone = undo(*model, pid.inner, kept.gauge_us, polarity.noise_um, left_um, asked_Hz)
        kept = undone.actuator
    tuned = with_axis(tuned, axis, actuator=kept)
    return Commissioned(
        axis, tuned, polarity, triangle, record, held_out, quality, tanh, affine, percent, actuator, pid, strain_closed,
        stage, outer, outer_loop, validation, undone, tuple(learned), None if tooth is None else tooth[0],
    )  # fmt: skip


def _close_strain(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    actuator: Actuator,
    polarity: Polarity,
    left_um: float,
    seed: int,
    say: Say,
    learned: list[str],
) -> tuple[Actuator, PidDesign, Sensitivity]:
    """PID for `actuator`, closed, and measured; once more from what was measured where it is not what was predicted."""
    by_bus = actuator.path != AT_ONCE
    for again in (False, True):
        settings = configuration.axes[axis]
        seen = over_path(actuator.system, actuator.path)
        hysteresis = settings.hysteresis
        assert isinstance(hysteresis, PrandtlIshlinskii)
        _, slopes = slopes_of(settings, actuator.swing_um, analyse_inverse(hysteresis, settings))
        if by_bus:
            slopes = (slopes[0], 1.0, max(slopes[-1], BUS_SLOPE))
        noise_um = polarity.noise_um
        pid = tune_pid(
            settings.inner,
            seen,
            slopes,
            careful=by_bus,
            radius=None if by_bus else actuator.found.radius_at,
            gain_dB=settings.accept.gain_margin_dB,
            phase_deg=settings.accept.phase_margin_deg,
            residual=float(np.clip(noise_um / max(left_um, 1e-6), 0.03, 0.5)),
        )
        say("sensitivity of the strain loop")
        closed = with_axis(configuration, axis, inner=pid.inner)
        measured = measure_strain_loop(closed, experiment, axis, seed + 10 + again)
        nominal = pid.margins[slopes.index(1.0)]
        period_s = configuration.loop.period_ns * 1e-9
        loop = judge_loop("strain loop", measured, actuator.system, strain_loop(pid.inner, seen), nominal)
        if loop.agrees or by_bus:
            return actuator, pid, loop
        learned.append(loop.sentence)
        found = identify(measured, period_s, Wanted(ORDERS, DELAYS))
        if found.problem is not None:
            learned.append(f"in the closed loop: {found.problem}")
            break
        actuator = replace(actuator, found=found)
    raise CheckFailed(
        f"axis {axis}: the tuning is withdrawn, the strain loop is not what was predicted: {'; '.join(learned)}. "
        f"{pid.limited_by[0].upper()}{pid.limited_by[1:]}"
    )


def _close_outer(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    actuator: Actuator,
    stage: StageModel,
    knobs: Knobs,
    seed: int,
    say: Say,
    learned: list[str],
) -> tuple[StageModel, OuterDesign, Sensitivity]:
    """The same for the outer loop; behind a bus it is judged as it is, by the lines that its samples show."""
    settings, period_s = configuration.axes[axis], configuration.loop.period_ns * 1e-9
    for again in (False, True):
        say("outer loop")
        hysteresis = settings.hysteresis
        assert isinstance(hysteresis, PrandtlIshlinskii)
        strain = analyse_strain(settings, actuator, analyse_inverse(hysteresis, settings)).side
        hertz = stage.found.measured.frequency_Hz
        relative = stage.found.radius / np.maximum(np.abs(stage.found.at(hertz)), 1e-12)
        by_bus = actuator.path.stage_cycles > 1 or actuator.path.stage_late > 0
        outer = tune_outer(
            stage.linear,
            period_s,
            stage.noise_um if knobs.noise_um is None else knobs.noise_um,
            unsure=None if by_bus else partial(_interpolated, hertz=hertz, values=relative),
            bears=Borne(stage.linear, strain, actuator, period_s, settings.accept),
            reach=_reach(settings, period_s),
            gain_dB=settings.accept.gain_margin_dB,
            phase_deg=settings.accept.phase_margin_deg,
            overshoot=0.01 * settings.accept.overshoot_percent,
            settling_s=1e-3 * settings.accept.settling_ms,
            bandwidth_Hz=knobs.bandwidth_Hz,
            oscillation_Hz=_tooth_Hz(knobs, settings),
            sample_cycles=actuator.path.stage_cycles,
            late_cycles=actuator.path.stage_late,
        )
        say("sensitivity of the outer loop")
        closed = with_axis(configuration, axis, outer=outer.outer)
        measured = measure_outer_loop(closed, experiment, axis, seed + 20 + again)
        gains, plant = outer_gains(outer.outer, None, period_s), stage.found.system()
        closed_loop = stage_loop(gains, plant, actuator.path.stage_cycles, actuator.path.stage_late)
        loop = judge_loop("outer loop", measured, plant, closed_loop, outer.margins)
        if loop.agrees or by_bus:
            return stage, outer, loop
        learned.append(loop.sentence)
        stage = with_response(stage, measured, period_s)
        if stage.found.problem is not None:
            learned.append(f"in the closed loop: {stage.found.problem}")
            break
    raise CheckFailed(
        f"axis {axis}: the tuning is withdrawn, the outer loop is not what was predicted: {'; '.join(learned)}"
    )


def _reach(settings: Axis, period_s: float) -> Reach:
    low, high = settings.setpoint.range_um
    nearer = min(settings.centre_um - low, high - settings.centre_um)
    return Reach(settings.setpoint.slew_um_per_ms * 1e3 * period_s, nearer)


def _tooth_Hz(knobs: Knobs, settings: Axis) -> float | None:
    if knobs.tooth_Hz is not None:
        return knobs.tooth_Hz
    return settings.outer.oscillation_Hz if settings.outer else knobs.tooth_seen_Hz


def _interpolated(omega: Array, hertz: Array, values: Array) -> Array:
    return np.asarray(np.interp(omega, 2 * np.pi * hertz, values))


def _holding_voltage(record: dict[str, Array], centre_um: float) -> float:
    """Voltage (V) at which an open-loop record passes the working point, the mean of both ways."""
    near = np.argsort(np.abs(record["strain_um"] - centre_um))[: max(len(record["strain_um"]) // 50, 10)]
    return float(np.median(record["voltage_V"][near]))


def _triangle(
    configuration: Configuration, experiment: Experiment, axis: str
) -> tuple[dict[str, Array], dict[str, float]]:
    """The recording, and how far the stages of the other axes moved (um)."""
    excitation = design(configuration, axis, "triangle", TRIANGLE_S, 0)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = experiment(variant(configuration), seconds, samples_for(configuration, excitation))
    travel = {name: float(np.ptp(rows["axis"]["stage_um"][:, i])) for i, name in enumerate(configuration.axes)}
    others = {name: um for name, um in travel.items() if name != axis and np.isfinite(um)}
    return recording(configuration, excitation, rows), others


def _as_record(axis: str, columns: dict[str, Array]) -> Record:
    voltage, strain = columns["voltage_V"], columns["strain_um"]
    return Record(Path(f"axis {axis}"), "voltage_V", "strain_um", voltage, strain, float(columns["t_s"][1]))


__all__ = ["DRAWN", "Commissioned", "Knobs", "Watched", "commission_axis"]
