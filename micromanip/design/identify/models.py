"""Models of every axis from experiments: hysteresis from the multisine, linear dynamics from noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micromanip.design.identify.hysteresis import fit
from micromanip.recordings import TimeSeries
from micromanip.settings.schema.axis import LinearModel
from micromanip.settings.schema.hysteresis import Range
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE

from ..experiment import (
    Experiment,
    alone,
    open_loop,
    path_bandwidth,
    play,
    require_answer,
    resting,
    within_slew,
)
from .experiments import design, recording, samples_for
from .hysteresis import HysteresisFit, structure_of
from .network.fit import white_noise
from .response import PERIOD_S, Identified, Measured, Recorded, Wanted, identify, identify_again, multisine

HYSTERESIS_S = 13.0
PLAYS, STARTS = 10, 4
OUTER_DELAY = 2
"""Cycles from a set-point to its answer where nothing is late."""
_DELAYS, _ORDERS = tuple(range(1, 8)), tuple(range(4, 17))
_RMS_UM = ((150.0, 0.7), (600.0, 1.2), (1500.0, 0.5), (4000.0, 0.2))
"""Upper frequency and rms of each part of the set-point's excitation; up to where the stack's own mode may be seen."""
_LOW_HZ, _LEAD_S, _SLEW_SHARE, _JUDGED_HZ = 8.0, 1.5, 0.7, 1500.0
_WANTED_ERROR, _WANTED_CONFIDENCE, _MATTERS = 0.12, 0.15, 0.05


def record_hysteresis(configuration: Configuration, experiment: Experiment, axis: str, seed: int = 1) -> TimeSeries:
    """Columns ``voltage_V, strain_um`` .. of one axis under the multisine (13), the other axes at rest."""
    excitation = design(configuration, axis, "multisine", HYSTERESIS_S, seed)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = experiment(open_loop(configuration), seconds, samples_for(configuration, excitation))
    return recording(configuration, excitation, rows)


def hysteresis_models(record: TimeSeries, limits: Range) -> tuple[HysteresisFit, HysteresisFit]:
    """Tanh and affine model of a record made by `record_hysteresis`, good for set-points within `limits` (um)."""
    structures = (structure_of(kind, record.u, record.step_s, PLAYS) for kind in ("pi-tanh", "pi-affine"))
    tanh, affine = (fit(each, record.u, record.y, limits, burn_in(record), starts=STARTS) for each in structures)
    return tanh, affine


def burn_in(record: TimeSeries) -> int:
    """Samples of a record that do not count: what happened before it is not known."""
    return len(record) // 10


@dataclass(frozen=True)
class StageModel:
    """The stage's linear model, what it was found from, and the rms (um) of the capacitive sensor's white noise."""

    linear: LinearModel
    found: Identified
    noise_um: float


def identify_stage(configuration: Configuration, experiment: Experiment, axis: str, seed: int) -> StageModel:
    """Measure `axis` under a multisine on its set-point, strain loop closed, the others parked; fit its dynamics.

    Raises CheckFailed where no response stands out of the noise, or the sensor has gaps.
    """
    rate_hz, i = configuration.loop.rate_hz, list(configuration.axes).index(axis)
    path = experiment.path(configuration, axis)
    cutoff_hz = min(_RMS_UM[-1][0], 0.4 * rate_hz, path_bandwidth(path, rate_hz))
    # behind a bus the excitation's band is too narrow to tell one cycle from the next: the delay is known
    delays = _DELAYS if path == AT_ONCE else (OUTER_DELAY + path.output_late,)
    wanted = Wanted(_ORDERS, delays, _WANTED_ERROR, _WANTED_CONFIDENCE, _MATTERS, _JUDGED_HZ)

    def record(attempt: int, longer: int) -> Recorded:
        wave = multisine(
            _RMS_UM,
            _LOW_HZ,
            cutoff_hz,
            rate_hz,
            seed=seed + attempt,
            period_s=PERIOD_S * longer,
            lead_s=_LEAD_S * longer,
        )
        samples = resting(configuration, axis, len(wave.samples))
        samples[:, i] += within_slew(configuration, axis, wave.samples, _SLEW_SHARE)
        rows = play(alone(configuration, axis, "strain"), experiment, samples)
        u, y = (np.asarray(rows[name][:, i], dtype=float) for name in ("setpoint_um", "stage_um"))
        require_answer(axis, "stage sensor", y)
        return wave, u, y

    tried = identify_again(
        record,
        wanted,
        f"axis {axis}: the stage can't be identified",
        "Look for a disturbance meanwhile, a loose flexure, or a sensor of another axis",
    )
    return StageModel(_linear(tried.found), tried.found, white_noise(tried.output))


def with_response(stage: StageModel, measured: Measured, period_s: float) -> StageModel:
    """The model of another measured response of the same stage, e.g. one in a closed loop."""
    found = identify(
        measured, period_s, Wanted(_ORDERS, _DELAYS, _WANTED_ERROR, _WANTED_CONFIDENCE, _MATTERS, _JUDGED_HZ)
    )
    return StageModel(_linear(found), found, stage.noise_um)


def _linear(found: Identified) -> LinearModel:
    system = found.dynamics()
    return LinearModel(
        A=tuple(tuple(float(v) for v in row) for row in system.A),
        B=tuple(float(v) for v in system.B),
        C=tuple(float(v) for v in system.C),
        delay_cycles=found.delay,
    )
