"""The paper's experiment: configurations A, B, C at 1, 5 and 10 Hz, on all axes at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import NoModel
from micromanip.settings.schema.model import Configuration

from ..experiment import Experiment, with_axis, with_reference
from ..identify.models import hysteresis_models, record_hysteresis
from . import paper

HOLD_S = 0.5
"""Rest at the offset before the sine begins."""
SETTLE_S = 1.0
"""Sigma and maximum count after the first period, and at least so long, of the sine."""
WINDOW_S = 2.0
SWINGS_ABOVE, _LINE_SHARE = 10.0, 0.02
"""Times the sine's frequency, above which it has no harmonics to speak of; how wide a line is, in terms of its own."""
TUNED = "D"
"""Configuration C with the PID that `commission` found, and with the axis' section `actuator`."""


@dataclass(frozen=True)
class Run:
    """One configuration at one frequency: telemetry rows from the beginning of the sine on."""

    config: str
    frequency_hz: float
    rows: NDArray[Any]
    settled: int
    rate_hz: int

    def error_um(self, axis: int) -> Array:
        """Reference minus measured strain-side position."""
        return np.asarray(self.rows["axis"]["reference_um"][:, axis] - self.rows["axis"]["strain_um"][:, axis])

    def true_error_um(self, axis: int) -> Array:
        """Reference minus the true, noise-free position."""
        return np.asarray(self.rows["axis"]["reference_um"][:, axis] - self.rows["axis"]["true_strain_um"][:, axis])

    def swings_Hz(self, axis: int) -> float | None:
        """Where a loop swings by itself: a line far above the sine that has most of the error's energy; else None."""
        settled = self.error_um(axis)[self.settled :]
        power = np.abs(np.fft.rfft((settled - settled.mean()) * np.hanning(len(settled)))) ** 2
        hertz = np.fft.rfftfreq(len(settled), 1.0 / self.rate_hz)
        line = hertz[np.argmax(np.where(hertz > SWINGS_ABOVE * self.frequency_hz, power, 0.0))]
        near = np.abs(hertz - line) <= _LINE_SHARE * line
        return float(line) if power[near].sum() > 0.5 * power.sum() else None

    def figures(self, name: str, axis: int) -> dict[str, Any]:
        """The row of the result table for one axis."""
        error, true = self.error_um(axis), self.true_error_um(axis)
        settled, true_settled = error[self.settled :], true[self.settled :]
        return {
            "axis": name,
            "frequency_hz": self.frequency_hz,
            "config": self.config,
            "std_error_um": float(settled.std()),
            "max_error_um": float(np.abs(settled).max()),
            "max_error_with_start_um": float(np.abs(error).max()),
            "swings_hz": self.swings_Hz(axis),
            "true_std_error_um": _known(true_settled.std()),
            "true_max_error_um": _known(np.abs(true_settled).max()),
        }


def _known(value: np.floating[Any]) -> float | None:
    """`value`; None where a real cell knows no true position."""
    return float(value) if np.isfinite(value) else None


def variant_of(axis: Axis, config: str, own_pid: bool) -> Axis:
    """`axis` as configuration A, B, C or D; with `own_pid` not with the anchor's PID."""
    pid = axis.inner if own_pid or config == TUNED else paper.ANCHOR_PID
    mode = "pid" if config == "A" else "pid+feedforward"
    model = axis.hysteresis_affine if config == "B" else axis.hysteresis
    if model is None or isinstance(model, NoModel):  # an axis that is not judged yet
        mode, model = "pid", NoModel(model="none")
    return axis.model_copy(
        update={
            "mode": "strain",
            "inner": pid.model_copy(update={"mode": mode}),
            "hysteresis": model,
            "actuator": axis.actuator if config == TUNED else None,
        }
    )


def with_models(configuration: Configuration, experiment: Experiment, say: Callable[[str], None]) -> Configuration:
    """`configuration`, with tanh and affine models fitted on the spot for the axes that have none."""
    for name, axis in configuration.axes.items():
        unknown = isinstance(axis.hysteresis, NoModel)
        if axis.hysteresis_affine is not None and not unknown:
            continue
        tanh, affine = hysteresis_models(record_hysteresis(configuration, experiment, name), axis.setpoint.range_um)
        say(
            f"axis {name} has no hysteresis models in the configuration, fitted: over {tanh.stroke_um:.0f} um of "
            f"stroke, residual rms affine {affine.rms_percent:.2f} %, tanh {tanh.rms_percent:.2f} %"
        )
        found = {"hysteresis": tanh.model if unknown else axis.hysteresis}
        configuration = with_axis(
            configuration, name, hysteresis_affine=axis.hysteresis_affine or affine.model, **found
        )
    return configuration


def evaluate(
    configuration: Configuration,
    experiment: Experiment,
    own_pid: bool = False,
    tuned: bool = False,
    progress: Callable[[], None] = lambda: None,
) -> list[Run]:
    """Nine runs (A, B and C at each frequency); `progress` is called after each.

    `tuned` adds D: C with the configuration's own PID instead of the anchor's.
    """
    runs, rate_hz = [], configuration.loop.rate_hz
    for config in (*paper.SIGMA_UM, *([TUNED] if tuned else [])):
        axes = {name: variant_of(axis, config, own_pid) for name, axis in configuration.axes.items()}
        variant = configuration.model_copy(update={"axes": axes})
        for frequency_hz in paper.FREQUENCIES_HZ:
            settle_s = max(SETTLE_S, 1.0 / frequency_hz)
            sine = with_reference(variant, paper.reference(frequency_hz, HOLD_S))
            rows = experiment(sine, HOLD_S + settle_s + WINDOW_S)
            runs.append(Run(config, frequency_hz, rows[round(HOLD_S * rate_hz) :], round(settle_s * rate_hz), rate_hz))
            progress()
    return runs


def table(runs: list[Run], configuration: Configuration) -> list[dict[str, Any]]:
    """Result rows of all axes, in the order axis, frequency, configuration."""
    rows = [run.figures(name, i) for i, name in enumerate(configuration.axes) for run in runs]
    order = {name: i for i, name in enumerate(configuration.axes)}
    return sorted(rows, key=lambda row: (order[row["axis"]], row["frequency_hz"], row["config"]))
