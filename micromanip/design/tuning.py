"""Models of every axis from experiments: hysteresis from the multisine, linear dynamics from noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.design.hysteresis import fit
from micromanip.settings.schema.axis import LinearModel, Outer
from micromanip.settings.schema.hysteresis import Range
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File

from .excitation import band_noise
from .experiment import Experiment, path_bandwidth, with_axes, with_axis, with_reference, working_points
from .hysteresis import HysteresisFit, structure_of
from .identification import design, recording, samples_for, variant
from .linear import LinearFit, fit_linear

Progress = Callable[[str], None]
Array = NDArray[np.float64]

HYSTERESIS_S = 13.0
PLAYS, STARTS = 10, 4
OUTER_S, OUTER_SETTLE_S = 6.0, 0.3
OUTER_RMS_UM, OUTER_CUTOFF_HZ = 1.5, 400.0
OUTER_ORDER, OUTER_DELAY, OUTER_BLOCK_ROWS, OUTER_FITTED = 6, 2, 40, 0.75


def record_hysteresis(
    configuration: Configuration, experiment: Experiment, axis: str, seed: int = 1
) -> dict[str, Array]:
    """Columns ``t_s, voltage_V, strain_um`` .. of one axis under the multisine (13), the other axes at rest."""
    excitation = design(configuration, axis, "multisine", HYSTERESIS_S, seed)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = experiment(variant(configuration), seconds, samples_for(configuration, excitation))
    return recording(configuration, excitation, rows)


def hysteresis_models(record: dict[str, Array], limits: Range) -> tuple[HysteresisFit, HysteresisFit]:
    """Tanh and affine model of a record made by `record_hysteresis`, good for set-points within `limits` (um)."""
    voltage, strain = record["voltage_V"], record["strain_um"]
    tanh, affine = (
        fit(
            structure_of(kind, voltage, float(record["t_s"][1]), PLAYS),
            voltage,
            strain,
            limits,
            burn_in(record),
            starts=STARTS,
        )
        for kind in ("pi-tanh", "pi-affine")
    )
    return tanh, affine


def burn_in(record: dict[str, Array]) -> int:
    """Samples of a record that do not count: what happened before it is not known."""
    return len(record["t_s"]) // 10


def fit_hysteresis(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """`configuration` with the tanh model as feedforward, and the affine one for comparison, in every axis."""
    for name, axis in configuration.axes.items():
        record = record_hysteresis(configuration, experiment, name)
        tanh, affine = hysteresis_models(record, axis.setpoint.range_um)
        say(
            f"axis {name}: hysteresis over {tanh.stroke_um:.0f} um of stroke, residual rms "
            f"affine {affine.rms_percent:.2f} %, tanh {tanh.rms_percent:.2f} %"
        )
        inner = axis.inner.model_copy(update={"mode": "pid+feedforward"})
        configuration = with_axis(
            configuration, name, hysteresis=tanh.model, hysteresis_affine=affine.model, inner=inner
        )
    return configuration


@dataclass(frozen=True)
class StageModel:
    """The stage's linear model with the record it was fitted to and judged by: set-point `u` and stage `y` (n,), um."""

    linear: LinearModel
    fitted: LinearFit
    u: Array
    y: Array
    fit_percent: float


def identify_stage(configuration: Configuration, experiment: Experiment, axis: str, seed: int) -> StageModel:
    """Record `axis` under noise on its set-point, the others at their working points, and fit its dynamics."""
    rate_hz, names = configuration.loop.rate_hz, list(configuration.axes)
    count, i = round(OUTER_S * rate_hz), names.index(axis)
    samples = working_points(configuration, count)
    path = experiment.path(configuration, axis)
    delay = OUTER_DELAY + path.output_late
    cutoff_hz = min(OUTER_CUTOFF_HZ, path_bandwidth(path, rate_hz))
    samples[:, i] += band_noise(OUTER_RMS_UM, cutoff_hz, rate_hz, count, seed)
    excited = with_reference(with_axes(configuration, mode="strain"), File(source="file", path="(excitation)"))
    rows = experiment(excited, OUTER_S, samples)[round(OUTER_SETTLE_S * rate_hz) :]
    u = rows["axis"]["setpoint_um"][:, i] - configuration.axes[axis].centre_um
    y = np.asarray(rows["axis"]["stage_um"][:, i], dtype=float)
    part = round(OUTER_FITTED * len(u))
    # the delay is given: the excitation's band is too narrow to tell one cycle from the next. Not refined: creep
    # and hum colour the error, so least squares on the free run is no better, and worse above that band
    model = fit_linear(
        [(u[:part], y[:part])],
        1.0 / rate_hz,
        OUTER_ORDER,
        delays=[delay],
        direct=False,
        block_rows=OUTER_BLOCK_ROWS,
        refinements=0,
    )
    held_out, _ = model.errors(u[part:, None], y[part:, None])
    A, B, C, _ = model.modes.state_space()
    linear = LinearModel(
        A=tuple(tuple(float(v) for v in row) for row in A),
        B=tuple(float(v) for v in B[:, 0]),
        C=tuple(float(v) for v in C[0]),
        delay_cycles=delay,
    )
    return StageModel(linear, model, u, y, float(held_out[0]))


def fit_outer(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """`configuration` with the stage's linear model of every axis; the axes are excited one by one."""
    for seed, (name, axis) in enumerate(configuration.axes.items()):
        found = identify_stage(configuration, experiment, name, seed)
        say(
            f"axis {name}: linear model of order {found.fitted.order} behind {found.linear.delay_cycles} cycles, "
            f"free run on held-out data {found.fit_percent:.1f} %"
        )
        knobs = axis.outer.model_copy(update={"model": found.linear}) if axis.outer else Outer(model=found.linear)
        configuration = with_axis(configuration, name, outer=knobs)
    return configuration


def tune(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """Both, in order: the linear model is that of the loop with its feedforward."""
    return fit_outer(fit_hysteresis(configuration, experiment, say), experiment, say)
