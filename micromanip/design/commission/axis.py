"""One axis from factory values to a tuning: move, excite, judge, model, synthesise, validate. Nothing is applied.

Every step works on the configuration that the step before has made; what goes wrong raises CheckFailed, with what was
seen and what to do, before a loop is closed that should not be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

from ..actuation import Actuator, identify_actuator
from ..experiment import Experiment, with_axis
from ..hysteresis import HysteresisFit
from ..identification import design, recording, samples_for, variant
from ..linear.frequency import FrequencyResponse, frequency_response
from ..loops import over_path
from ..record import Record, judge_record
from ..synthesis import OuterDesign, PidDesign, tune_outer, tune_pid
from ..tuning import StageModel, burn_in, hysteresis_models, identify_stage, record_hysteresis
from .polarity import Polarity, check_polarity
from .quality import HELD_OUT_PERCENT, Quality, judge_coverage
from .validation import Validation, validate

Array = NDArray[np.float64]
Say = Callable[[str], None]

SLOPES, BUS_SLOPES = (0.75, 1.0, 1.3), (0.75, 1.0, 1.45)
"""The PID holds its margins for these multiples of the actuator's slope: hysteresis, amplitude, ageing; more of them
where the samples of a bus show less of the actuator."""
TRIANGLE_S = 12.0
_COHERENCE_SEGMENT = 1 << 13


@dataclass(frozen=True)
class Knobs:
    """What a human may ask for; None leaves it to the margins and to what was measured."""

    bandwidth_Hz: float | None = None
    noise_um: float | None = None


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
    stage: StageModel
    response: FrequencyResponse
    outer: OuterDesign
    validation: Validation


def commission_axis(
    configuration: Configuration, experiment: Experiment, axis: str, say: Say, knobs: Knobs | None = None, seed: int = 1
) -> Commissioned:
    """All steps for one axis; raises CheckFailed where one of them says no."""
    settings, knobs = configuration.axes[axis], knobs or Knobs()
    say("polarity and scale")
    polarity = check_polarity(configuration, experiment, axis)
    say("major loop")
    triangle = _triangle(configuration, experiment, axis)
    say("excitation")
    record, held_out = (record_hysteresis(configuration, experiment, axis, each) for each in (seed, seed + 1))
    judge_record(_as_record(axis, record))
    quality = judge_coverage(axis, record["voltage_V"], record["strain_um"], settings.setpoint.range_um)
    say("hysteresis models")
    tanh, affine = hysteresis_models(record, settings.setpoint.range_um)
    percent = {
        fitted.structure.name: fitted.held_out(held_out["voltage_V"], held_out["strain_um"], burn_in(held_out))[0]
        for fitted in (tanh, affine)
    }
    if min(percent.values()) > HELD_OUT_PERCENT:
        raise CheckFailed(
            f"axis {axis}: no hysteresis model predicts the second record better than to {min(percent.values()):.1f} % "
            f"of the stroke, {HELD_OUT_PERCENT:g} % are needed: look for slip, a loose gauge or a disturbance meanwhile"
        )
    say("actuator")
    actuator = identify_actuator(configuration, experiment, axis, seed)
    say("strain PID")
    by_bus = actuator.path != AT_ONCE
    seen, slopes = over_path(actuator.dynamics, actuator.path), BUS_SLOPES if by_bus else SLOPES
    pid = tune_pid(settings.inner, seen, slopes, careful=by_bus)
    tuned = with_axis(configuration, axis, hysteresis=tanh.model, hysteresis_affine=affine.model, inner=pid.inner)
    say("stage dynamics")
    stage = identify_stage(tuned, experiment, axis, seed)
    period_s = configuration.loop.period_ns * 1e-9
    response = frequency_response([(stage.u[:, None], stage.y[:, None])], period_s, _COHERENCE_SEGMENT)
    say("outer loop")
    outer = tune_outer(
        stage.linear,
        period_s,
        knobs.noise_um or _sensor_noise(stage),
        bandwidth_Hz=knobs.bandwidth_Hz,
        oscillation_Hz=settings.outer.oscillation_Hz if settings.outer else 200.0,
        sample_cycles=actuator.path.stage_cycles,
        late_cycles=actuator.path.stage_late,
    )
    tuned = with_axis(tuned, axis, outer=outer.outer)
    say("validation")
    validation = validate(tuned, experiment, axis)
    return Commissioned(
        axis, tuned, polarity, triangle, record, held_out, quality, tanh, affine, percent, actuator, pid, stage,
        response, outer, validation,
    )  # fmt: skip


def _triangle(configuration: Configuration, experiment: Experiment, axis: str) -> dict[str, Array]:
    excitation = design(configuration, axis, "triangle", TRIANGLE_S, 0)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = experiment(variant(configuration), seconds, samples_for(configuration, excitation))
    return recording(configuration, excitation, rows)


def _as_record(axis: str, columns: dict[str, Array]) -> Record:
    voltage, strain = columns["voltage_V"], columns["strain_um"]
    return Record(Path(f"axis {axis}"), "voltage_V", "strain_um", voltage, strain, float(columns["t_s"][1]))


def _sensor_noise(stage: StageModel) -> float:
    """Rms (um) of the capacitive sensor's white noise: what fourth differences leave of the movement."""
    return float(np.median(np.abs(np.diff(stage.y, 4))) / 0.6745 / np.sqrt(70.0))


class Watched:
    """An experiment that raises CheckFailed where a fault ended it."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def __call__(
        self, configuration: Configuration, seconds: float, samples: Array | None = None, every: int = 1
    ) -> NDArray[np.void]:
        """The rows of the experiment."""
        rows = self._experiment(configuration, seconds, samples, every)
        faults = rows["fault"][rows["fault"] != 0]
        if len(faults):
            raise CheckFailed(f"the experiment was ended by fault {KINDS[int(faults[0])].code}; nothing was tuned")
        return rows

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return self._experiment.path(configuration, axis)


__all__ = ["SLOPES", "Commissioned", "Knobs", "Watched", "commission_axis"]
