"""One axis from factory values to a tuning: move, excite, judge, model, synthesise, validate. Nothing is applied.

Every step works on the configuration that the step before has made; what goes wrong raises CheckFailed, with what was
seen and what to do, before a loop is closed that should not be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE

from ..analyse.loop_analysis import analyse_inverse
from ..analyse.loops import over_path
from ..analyse.sensitivity import Sensitivity
from ..data import judge_record
from ..experiment import Experiment, open_loop, with_axis
from ..identify.actuation import Actuator, identify_actuator
from ..identify.experiments import design, recording, samples_for
from ..identify.hysteresis import HysteresisFit
from ..identify.models import burn_in, hysteresis_models, identify_stage, record_hysteresis
from ..synthesise import InvertedActuator, PidDesign, invert_actuator
from .closing import Bench, ClosedOuter, Options, close_strain, prove_outer
from .guarded_experiment import GuardedExperiment, Say, Steps
from .limit_cycle import Rest, strain_at_rest
from .polarity import Polarity, check_polarity, check_rest, require_quiet
from .prices import Price
from .quality import HELD_OUT_PERCENT, Quality, judge_coverage, steepest_branch
from .quiescent_spectrum import tooth_at_work
from .stage_sensor_check import BEFORE_S, check_answer, check_travel, require_centred
from .validation import coupling

TRIANGLE_S = 12.0
FOLLOWED = 0.7
"""The set-point may move at this share of what the output can do."""


@dataclass(frozen=True)
class Commissioned:
    """Everything that was found about one axis; `configuration` holds its new tuning.

    `outer` is None where no outer loop could be proven: `without_outer` says why, and the axis runs in mode strain.
    """

    axis: str
    configuration: Configuration
    polarity: Polarity
    triangle: TimeSeries
    record: TimeSeries
    held_out: TimeSeries
    quality: Quality
    tanh: HysteresisFit
    affine: HysteresisFit
    held_out_percent: dict[str, float]
    actuator: Actuator
    pid: PidDesign
    strain_loop: Sensitivity
    strain_rest: Rest
    outer: ClosedOuter | None
    without_outer: str
    coupling: dict[str, float]
    """Share of this axis' movement that each other gauge, and each other stage sensor, sees."""
    undone: InvertedActuator | None = None
    """What the feedforward of mode strain undoes; None where the configuration does not say how late the gauge is."""
    learned: tuple[str, ...] = ()
    """What was measured, found wanting and done again, in sentences."""
    tooth_Hz: float | None = None
    """Tooth-passing frequency that was seen while the axis stood where it works; None: not looked for, or none."""
    strain_prices: tuple[Price, ...] = ()


def commission_axis(
    configuration: Configuration,
    experiment: GuardedExperiment,
    axis: str,
    say: Say,
    options: Options | None = None,
    seed: int = 1,
    running: Experiment | None = None,
) -> Commissioned:
    """All steps for one axis; raises Stopped, with what was found by then, where one of them says no.

    In `running` the process goes on: a tooth that nobody has told or seen is looked for in it.
    """
    steps = Steps(axis, say)
    with steps.kept(lambda: experiment.stalled):
        return _commission(configuration, experiment, axis, steps, options or Options(), seed, running)


def _commission(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    steps: Steps,
    options: Options,
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
    configuration = followable(configuration, axis, polarity.slope_um_per_V)
    settings = settings.model_copy(update={"setpoint": configuration.axes[axis].setpoint})
    steps.learn(setpoints_slew_limit=f"{settings.setpoint.slew_um_per_ms:g} um/ms")
    say("major loop")
    triangle, others_um = _triangle(configuration, experiment, axis)
    judge_coverage(axis, triangle.u, triangle.y, settings.setpoint.range_um)
    travel = None
    if f"stage_{axis}" in configuration.signals:
        travel = check_travel(configuration, axis, triangle, others_um)
        steps.learn(stage_over_gauge=f"{travel.slope:.2f}")
    say("answer to a step")
    answer = check_answer(configuration, experiment, axis, _holding_voltage(triangle, settings.centre_um))
    steps.learn(gauge_after_a_step=f"63 % in {answer.rise_ms:.1f} ms")
    if travel is not None:
        require_centred(configuration, axis, travel)
        way_um = abs(travel.slope) * float(np.ptp(settings.setpoint.range_um))
        require_quiet(axis, "stage sensor", answer.stage_before_um, way_um, BEFORE_S)
    say("excitation")
    record, held_out = (record_hysteresis(configuration, experiment, axis, each) for each in (seed, seed + 1))
    judge_record(record)
    quality = judge_coverage(axis, record.u, record.y, settings.setpoint.range_um)
    steps.learn(stroke=f"{np.ptp(record.y):.0f} um", coverage=f"{100 * quality.coverage:.0f} % of the set-points")
    say("hysteresis models")
    tanh, affine = hysteresis_models(record, settings.setpoint.range_um)
    percent = {
        fitted.structure.name: fitted.held_out(held_out.u, held_out.y, burn_in(held_out))[0]
        for fitted in (tanh, affine)
    }
    steps.learn(hysteresis_on_unseen_data=f"{min(percent.values()):.2f} % of the stroke")
    if min(percent.values()) > HELD_OUT_PERCENT:
        raise CheckFailed(
            f"axis {axis}: no hysteresis model predicts the second record better than to {min(percent.values()):.1f} % "
            f"of the stroke, {HELD_OUT_PERCENT:g} % are needed: look for slip, a loose gauge or a disturbance meanwhile"
            f"{answer.slow(max(settings.accept.frequencies_Hz))}"
        )
    learned: list[str] = []
    chosen = _regular(settings, tanh, affine, learned)
    tuned = with_axis(configuration, axis, hysteresis=chosen.model, hysteresis_affine=affine.model)
    say("actuator")
    actuator = identify_actuator(configuration, experiment, axis, seed, _holding_voltage(record, settings.centre_um))
    branch_um_per_V = steepest_branch(triangle.u, triangle.y, settings.setpoint.range_um)
    actuator = replace(actuator, branch_um_per_V=branch_um_per_V)
    steps.learn(
        actuator=f"order {actuator.found.order}, delay {actuator.delay} cycles, fit "
        f"{actuator.found.fit_percent:.1f} % about {actuator.centre_V:.0f} V"
    )
    say("strain PID")
    left_um = 0.01 * percent[chosen.structure.name] * tanh.stroke_um
    bench = Bench(tuned, experiment, axis, seed, say, learned)
    actuator, pid, strain_closed, strain_prices = close_strain(bench, actuator, polarity.noise_um, left_um)
    tuned = with_axis(tuned, axis, inner=pid.inner)
    steps.learn(
        strain_PID=f"K {pid.inner.K_V_per_um:g} V/um, Ti {pid.inner.Ti_ms:g} ms, Td {pid.inner.Td_ms:g} ms, filter "
        f"{pid.inner.filter_ms:g} ms; {pid.limited_by}",
        strain_loop=strain_closed.sentence,
    )
    strain_rest, inner = strain_at_rest(tuned, experiment, axis)
    steps.learn(gauge_at_rest=strain_rest.told)
    tooth = None
    if running is not None and settings.outer is None and options.tooth(settings) is None:
        say("tooth where it works")
        try:
            tooth = tooth_at_work(tuned, running, axis)
        except CheckFailed as problem:  # of the process alone: without it the axis can still be tuned
            learned.append(f"with the process, where it works: {problem}")
        if tooth is not None:
            options = replace(options, tooth_seen_Hz=tooth[0])
            steps.learn(tooth_where_it_works=f"{tooth[1]:.2f} um at {tooth[0]:g} Hz")
    outer, without = None, "the axis has no stage sensor"
    if travel is not None:
        say("stage dynamics")
        stage = identify_stage(tuned, experiment, axis, seed)
        try:
            outer = prove_outer(replace(bench, configuration=tuned), actuator, stage, options, inner)
        except CheckFailed as problem:  # the strain loop is proven: it is not thrown away
            without = str(problem)
            steps.learn(no_outer_loop=without)
        else:
            tuned = with_axis(tuned, axis, outer=outer.design.outer)
    if outer is None:
        tuned = with_axis(tuned, axis, outer=None, mode="strain")
    undone, kept = None, settings.actuator
    if kept is not None and actuator.path == AT_ONCE:
        asked_Hz = settings.accept.frequencies_Hz
        model, accept = (actuator.dynamics, actuator.delay), settings.accept
        seen = over_path(actuator.system, actuator.path)
        undone = invert_actuator(
            *model, pid.inner, kept.gauge_us, polarity.noise_um, left_um, asked_Hz,
            lambda share: pid.bears(share, seen, accept.gain_margin_dB, accept.phase_margin_deg),
        )  # fmt: skip
        kept = undone.actuator
    tuned = with_axis(tuned, axis, actuator=kept)
    if settings.untuned and outer is not None:  # it said nothing of how it is to run
        tuned = with_axis(tuned, axis, mode="stage")
    return Commissioned(
        axis, tuned, polarity, triangle, record, held_out, quality, tanh, affine, percent, actuator, pid, strain_closed,
        strain_rest, outer, without, coupling(tuned, experiment, axis), undone, tuple(learned),
        None if tooth is None else tooth[0], strain_prices,
    )  # fmt: skip


def followable(configuration: Configuration, axis: str, slope_um_per_V: float) -> Configuration:
    """With a set-point no faster than its output can follow: beyond, the outer loop's model is wrong."""
    setpoint, output = configuration.axes[axis].setpoint, configuration.outputs[f"voltage_{axis}"]
    most = FOLLOWED * slope_um_per_V * output.slew_V_per_ms
    if setpoint.slew_um_per_ms <= most:
        return configuration
    slower = float(f"{0.99 * most:.2g}")
    return with_axis(configuration, axis, setpoint=setpoint.model_copy(update={"slew_um_per_ms": slower}))


def _regular(settings: Axis, tanh: HysteresisFit, affine: HysteresisFit, learned: list[str]) -> HysteresisFit:
    """The model that runs as feedforward: tanh, unless only the affine one has a regular inverse."""
    problems = analyse_inverse(tanh.model, settings).verdict.problems
    if not problems or analyse_inverse(affine.model, settings).verdict.problems:
        return tanh
    learned.append(f"the tanh model has no regular inverse ({problems[0]}): the affine model runs")
    return affine


def _holding_voltage(record: TimeSeries, centre_um: float) -> float:
    """Voltage (V) at which an open-loop record passes the working point, the mean of both ways."""
    near = np.argsort(np.abs(record.y - centre_um))[: max(len(record) // 50, 10)]
    return float(np.median(record.u[near]))


def _triangle(configuration: Configuration, experiment: Experiment, axis: str) -> tuple[TimeSeries, dict[str, float]]:
    """The recording, and how far the stages of the other axes moved (um)."""
    excitation = design(configuration, axis, "triangle", TRIANGLE_S, 0)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = experiment(open_loop(configuration), seconds, samples_for(configuration, excitation))
    travel = {name: float(np.ptp(rows["axis"]["stage_um"][:, i])) for i, name in enumerate(configuration.axes)}
    others = {name: um for name, um in travel.items() if name != axis and np.isfinite(um)}
    return recording(configuration, excitation, rows), others
