"""Models of every axis from experiments: hysteresis from the multisine, linear dynamics from noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.records import MAX_AXES
from micromanip.settings.axis import LinearModel, Outer
from micromanip.settings.model import Configuration
from micromanip.settings.reference import File

from .excitation import band_noise
from .experiment import Experiment, with_axes, with_axis, with_reference
from .hysteresis import fit, structure_of
from .identification import design, recording, samples_for, variant
from .linear import fit_linear

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


def fit_hysteresis(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """`configuration` with the tanh model as feedforward, and the affine one for comparison, in every axis."""
    for name, axis in configuration.axes.items():
        columns = record_hysteresis(configuration, experiment, name)
        voltage, strain = columns["voltage_V"], columns["strain_um"]
        step_s, limits = float(columns["t_s"][1]), axis.setpoint.range_um
        burn_in = len(voltage) // 10
        tanh, affine = (
            fit(structure_of(kind, voltage, step_s, PLAYS), voltage, strain, limits, burn_in, starts=STARTS)
            for kind in ("pi-tanh", "pi-affine")
        )
        say(
            f"axis {name}: hysteresis over {tanh.stroke_um:.0f} um of stroke, residual rms "
            f"affine {affine.rms_percent:.2f} %, tanh {tanh.rms_percent:.2f} %"
        )
        inner = axis.inner.model_copy(update={"mode": "pid+feedforward"})
        configuration = with_axis(
            configuration, name, hysteresis=tanh.model, hysteresis_affine=affine.model, inner=inner
        )
    return configuration


def fit_outer(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """`configuration` with the stage's linear model of every axis; the axes are excited one by one."""
    rate_hz = configuration.loop.rate_hz
    count = round(OUTER_S * rate_hz)
    for i, (name, axis) in enumerate(configuration.axes.items()):
        samples = np.zeros((count, MAX_AXES))
        samples[:] = [other.centre_um for other in configuration.axes.values()] + [0.0] * (
            MAX_AXES - len(configuration.axes)
        )
        samples[:, i] += band_noise(OUTER_RMS_UM, OUTER_CUTOFF_HZ, rate_hz, count, seed=i)
        excited = with_reference(with_axes(configuration, mode="strain"), File(source="file", path="(excitation)"))
        rows = experiment(excited, OUTER_S, samples)[round(OUTER_SETTLE_S * rate_hz) :]
        u = rows["axis"]["setpoint_um"][:, i] - axis.centre_um
        y = rows["axis"]["stage_um"][:, i]
        fitted = round(OUTER_FITTED * len(u))
        # the delay is given: the excitation's band is too narrow to tell one cycle from the next. Not refined: creep
        # and hum colour the error, so least squares on the free run is no better, and worse above that band
        model = fit_linear(
            [(u[:fitted], y[:fitted])],
            1.0 / rate_hz,
            OUTER_ORDER,
            delays=[OUTER_DELAY],
            direct=False,
            block_rows=OUTER_BLOCK_ROWS,
            refinements=0,
        )
        held_out, _ = model.errors(u[fitted:, None], y[fitted:, None])
        say(
            f"axis {name}: linear model of order {model.order} behind {OUTER_DELAY} cycles, "
            f"free run on held-out data {held_out[0]:.1f} %"
        )
        A, B, C, _ = model.modes.state_space()
        linear = LinearModel(
            A=tuple(tuple(float(v) for v in row) for row in A),
            B=tuple(float(v) for v in B[:, 0]),
            C=tuple(float(v) for v in C[0]),
            delay_cycles=OUTER_DELAY,
        )
        knobs = axis.outer.model_copy(update={"model": linear}) if axis.outer else Outer(model=linear)
        configuration = with_axis(configuration, name, outer=knobs)
    return configuration


def tune(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """Both, in order: the linear model is that of the loop with its feedforward."""
    return fit_outer(fit_hysteresis(configuration, experiment, say), experiment, say)
