"""Models of every axis from experiments: hysteresis from the multisine, linear dynamics from noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from micromanip.rt.records import MAX_AXES
from micromanip.settings.axis import LinearModel, Outer
from micromanip.settings.model import Configuration
from micromanip.settings.reference import File

from .excitation import band_noise, identification_sines
from .experiment import Experiment, with_axes, with_axis, with_reference
from .hysteresis import fit_prandtl_ishlinskii
from .subspace import fit_siso

Progress = Callable[[str], None]

HYSTERESIS_S, HYSTERESIS_EVERY = 13.0, 10
OUTER_S, OUTER_SETTLE_S = 6.0, 0.3
OUTER_RMS_UM, OUTER_CUTOFF_HZ = 1.5, 400.0
OUTER_ORDER, OUTER_DELAY = 6, 2


def fit_hysteresis(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """`configuration` with the tanh model as feedforward, and the affine one for comparison, in every axis."""
    excited = with_reference(with_axes(configuration, mode="voltage"), identification_sines())
    rows = experiment(excited, HYSTERESIS_S, every=HYSTERESIS_EVERY)
    burn_in = len(rows) // 10
    for i, (name, axis) in enumerate(configuration.axes.items()):
        voltage = np.ascontiguousarray(rows["axis"]["voltage_V"][:, i])
        strain = np.ascontiguousarray(rows["axis"]["strain_um"][:, i])
        limits = axis.setpoint.range_um
        tanh = fit_prandtl_ishlinskii(voltage, strain, "tanh", limits, burn_in=burn_in)
        affine = fit_prandtl_ishlinskii(voltage, strain, "affine", limits, burn_in=burn_in)
        stroke = float(np.ptp(strain[burn_in:]))
        say(
            f"axis {name}: hysteresis over {stroke:.0f} um of stroke, residual rms "
            f"affine {100 * affine.rms_um / stroke:.2f} %, tanh {100 * tanh.rms_um / stroke:.2f} %"
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
        model = fit_siso(u - u.mean(), y - y.mean(), OUTER_ORDER, OUTER_DELAY)
        say(f"axis {name}: linear model of order {OUTER_ORDER}, free run on held-out data {model.fit_percent:.1f} %")
        linear = LinearModel(
            A=tuple(tuple(float(v) for v in row) for row in model.A),
            B=tuple(float(v) for v in model.B),
            C=tuple(float(v) for v in model.C),
            delay_cycles=OUTER_DELAY,
        )
        knobs = axis.outer.model_copy(update={"model": linear}) if axis.outer else Outer(model=linear)
        configuration = with_axis(configuration, name, outer=knobs)
    return configuration


def tune(configuration: Configuration, experiment: Experiment, say: Progress) -> Configuration:
    """Both, in order: the linear model is that of the loop with its feedforward."""
    return fit_outer(fit_hysteresis(configuration, experiment, say), experiment, say)
