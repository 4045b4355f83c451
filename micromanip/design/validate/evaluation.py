"""The paper's experiment: configurations A, B, C at 1, 5 and 10 Hz, on all axes at once.

Beyond the paper C, and D where there is one, on small sines of 50 to 150 Hz, told as a share of the stroke, peak to
peak, as the literature on scanning microscopes does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import NoModel
from micromanip.settings.schema.model import Configuration

from ..experiment import Experiment, with_reference
from ..identify.models import fit_hysteresis
from . import paper

HOLD_S = 0.5
"""Rest at the offset before the sine begins."""
SETTLE_S = 1.0
"""Sigma and maximum count after the first period, and at least so long, of the sine."""
WINDOW_S, FAST_WINDOW_S = 2.0, 1.0
SWINGS_ABOVE, _LINE_SHARE = 10.0, 0.02
"""Times the sine's frequency, above which it has no harmonics to speak of; how wide a line is, in terms of its own."""
TUNED = "D"
"""Configuration C with the PID that `commission` found, and with the axis' section `actuator`."""

Array = NDArray[np.float64]


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


@dataclass(frozen=True)
class Faulted:
    """A sine that ended in a fault."""

    config: str
    frequency_hz: float
    why: str

    def figures(self, name: str) -> dict[str, Any]:
        """The row of the fast sines' table for one axis: none."""
        unknown = (
            "std_error_um", "max_error_um", "max_error_with_start_um", "true_std_error_um", "true_max_error_um",
            "swings_hz", "true_rms_percent",
        )  # fmt: skip
        told = {"axis": name, "frequency_hz": self.frequency_hz, "config": self.config, "amplitude_um": paper.FAST_UM}
        return told | dict.fromkeys(unknown) | {"refused": self.why}


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
    """`configuration`, with models fitted on the spot for the axes that have none."""
    missing = [
        name
        for name, axis in configuration.axes.items()
        if axis.hysteresis_affine is None or isinstance(axis.hysteresis, NoModel)
    ]
    if not missing:
        return configuration
    say(f"no hysteresis models for {', '.join(missing)} in the configuration: fitting them")
    fitted = fit_hysteresis(configuration, experiment, say)
    axes = {name: _completed(axis, fitted.axes[name]) for name, axis in configuration.axes.items()}
    return configuration.model_copy(update={"axes": axes})


def _completed(axis: Axis, fitted: Axis) -> Axis:
    """`axis` with the models of `fitted` where it has none of its own."""
    model = fitted.hysteresis if isinstance(axis.hysteresis, NoModel) else axis.hysteresis
    return axis.model_copy(
        update={"hysteresis": model, "hysteresis_affine": axis.hysteresis_affine or fitted.hysteresis_affine}
    )


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
    configs = (*paper.SIGMA_UM, *([TUNED] if tuned else []))
    sines = [(frequency_hz, paper.AMPLITUDE_UM, WINDOW_S) for frequency_hz in paper.FREQUENCIES_HZ]
    return _played(configuration, experiment, configs, own_pid, sines, progress)


def evaluate_fast(
    configuration: Configuration,
    experiment: Experiment,
    tuned: bool = False,
    progress: Callable[[], None] = lambda: None,
) -> list[Run | Faulted]:
    """C, and with `tuned` D, on a sine of ``paper.FAST_UM`` at each of ``paper.FAST_HZ``; `progress` after each.

    A stage that resonates at one of them may not bear it: the others are played all the same.
    """
    found: list[Run | Faulted] = []
    for config in ("C", *([TUNED] if tuned else [])):
        for frequency_hz in paper.FAST_HZ:
            sine = (frequency_hz, paper.FAST_UM, FAST_WINDOW_S)
            try:
                found += _played(configuration, experiment, (config,), False, [sine], progress)
            except CheckFailed as problem:
                found.append(Faulted(config, frequency_hz, str(problem)))
                progress()
    return found


def _played(
    configuration: Configuration,
    experiment: Experiment,
    configs: Sequence[str],
    own_pid: bool,
    sines: Sequence[tuple[float, float, float]],
    progress: Callable[[], None],
) -> list[Run]:
    """Sines (Hz, um, and s to look at it once it has settled), in each of the configurations."""
    runs, rate_hz = [], configuration.loop.rate_hz
    for config in configs:
        axes = {name: variant_of(axis, config, own_pid) for name, axis in configuration.axes.items()}
        variant = configuration.model_copy(update={"axes": axes})
        for frequency_hz, amplitude_um, window_s in sines:
            settle_s = max(SETTLE_S, 1.0 / frequency_hz)
            reference = paper.reference(frequency_hz, HOLD_S, amplitude_um)
            rows = experiment(with_reference(variant, reference), HOLD_S + settle_s + window_s)
            runs.append(Run(config, frequency_hz, rows[round(HOLD_S * rate_hz) :], round(settle_s * rate_hz), rate_hz))
            progress()
    return runs


def fast_table(runs: Sequence[Run | Faulted], configuration: Configuration) -> list[dict[str, Any]]:
    """Rows of `evaluate_fast` as those of `table`, with the true error's rms in percent of the stroke.

    Of a sine that ended in a fault there is no figure, and ``refused`` is the reason.
    """
    rows = []
    for i, name in enumerate(configuration.axes):
        for run in sorted(runs, key=lambda each: (each.frequency_hz, each.config)):
            if isinstance(run, Faulted):
                rows.append(run.figures(name))
                continue
            rms_um = np.sqrt(np.mean(run.true_error_um(i)[run.settled :] ** 2))
            share = {
                "refused": None,
                "amplitude_um": paper.FAST_UM,
                "true_rms_percent": _known(100.0 * rms_um / (2.0 * paper.FAST_UM)),
            }
            rows.append(run.figures(name, i) | share)
    return rows


def table(runs: list[Run], configuration: Configuration) -> list[dict[str, Any]]:
    """Result rows of all axes, in the order axis, frequency, configuration."""
    rows = [run.figures(name, i) for i, name in enumerate(configuration.axes) for run in runs]
    order = {name: i for i, name in enumerate(configuration.axes)}
    return sorted(rows, key=lambda row: (order[row["axis"]], row["frequency_hz"], row["config"]))
