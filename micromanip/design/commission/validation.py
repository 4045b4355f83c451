"""Fresh experiments with the new tuning: sines on the gauge, a path and a step of the stage, what the others see.

The sines stay inside the set-point's range, whatever it is; the other axes rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micromanip.control.system import Array
from micromanip.settings.schema.model import Configuration

from ..experiment import EXCITED, Experiment, alone, parked, play, resting, with_reference
from ..validate.evaluation import HOLD_S, SETTLE_S, WINDOW_S, Run, variant_of
from ..validate.step import StepAnswer, course, judge_step
from .limit_cycle import Held, Rest, stage_at_rest

_BEFORE_S, _AFTER_S = 0.5, 0.5
_MOVE_UM, _MOVE_S = 20.0, 1.0


@dataclass(frozen=True)
class Validation:
    """`step` (t_s, reference_um, stage_um) of the closed outer loop, and its `answer`.
    `settled_um`: its error at the end, rms; `rest`: the stage while nothing is asked of it.
    `path_um`: rms error on a sine of `path_amplitude_um`.
    """

    step: tuple[Array, Array, Array]
    answer: StepAnswer
    settled_um: float
    rest: Rest
    path_um: float
    path_amplitude_um: float


def validate(configuration: Configuration, experiment: Experiment, axis: str, inner: Held) -> Validation:
    """Play the experiments on `axis`; the other axes are parked. `inner` is the axis with the strain loop alone."""
    rate_hz, i = configuration.loop.rate_hz, list(configuration.axes).index(axis)
    before, after = round(_BEFORE_S * rate_hz), round(_AFTER_S * rate_hz)
    samples = parked(configuration, before + after)
    samples[:, i] = course((np.arange(before + after) - before) / rate_hz)
    rows = play(alone(configuration, axis, "stage"), experiment, samples)[:, i]
    t_s = (np.arange(len(rows)) - before) / rate_hz
    stage, reference = (np.asarray(rows[name], dtype=float) for name in ("stage_um", "reference_um"))
    late = t_s > 0.6 * _AFTER_S
    settled = float(np.sqrt(np.mean((stage - reference)[late] ** 2)))
    rest = stage_at_rest(configuration, experiment, axis, inner)
    answer = judge_step(t_s, stage, rest.floor_um)
    near = (t_s > -0.02) & (t_s < 0.15)
    step = t_s[near], reference[near], stage[near]
    path_um, amplitude_um = path_error(configuration, experiment, axis)
    return Validation(step, answer, settled, rest, path_um, amplitude_um)


def coupling(configuration: Configuration, experiment: Experiment, axis: str) -> dict[str, float]:
    """Move the axis' set-point slowly up and down; what the others' sensors see of it, by signal name."""
    rate_hz, names = configuration.loop.rate_hz, list(configuration.axes)
    count, i = round(_MOVE_S * rate_hz), names.index(axis)
    samples = resting(configuration, axis, count)
    samples[:, i] += _MOVE_UM * np.sin(2 * np.pi * np.arange(count) / count)
    rows = play(alone(configuration, axis, "strain"), experiment, samples)
    seen = {}
    for role in ("strain", "stage"):
        moved = rows[f"{role}_um"]
        own = moved[:, i] - moved[:, i].mean()
        if not np.isfinite(own).all():
            continue
        for k, name in enumerate(names):
            other = moved[:, k] - moved[:, k].mean()
            if k != i and np.isfinite(other).all():
                seen[f"{role}_{name}"] = float(other @ own / (own @ own))
    return seen


CONFIGS = ("A", "B", "C")
_PATH_SHARE, _PATH_UM, _PATH_S = 0.15, 20.0, 2.0


def asked(configuration: Configuration, axis: str) -> tuple[float, float]:
    """Middle and amplitude (um) of the sine on the gauge, by `accept`, inside the set-point's range."""
    settings = configuration.axes[axis]
    low, high = settings.setpoint.range_um
    room = 0.5 * (high - low)
    wanted = 0.5 * room if settings.accept.stroke_um is None else 0.5 * settings.accept.stroke_um
    return 0.5 * (low + high), min(wanted, room)


def follow(configuration: Configuration, experiment: Experiment, axis: str) -> list[Run]:
    """Configurations A, B and C of `axis` with its own PID on every sine that is asked for."""
    sine_um, rate_hz, runs = asked(configuration, axis), configuration.loop.rate_hz, []
    index = list(configuration.axes).index(axis)
    for config in CONFIGS:
        only = alone(configuration, axis, "strain")
        variant = only.model_copy(update={"axes": only.axes | {axis: variant_of(only.axes[axis], config, True)}})
        for hertz in configuration.axes[axis].accept.frequencies_Hz:
            settle_s = max(SETTLE_S, 1.0 / hertz)
            samples = _wave(configuration, index, *sine_um, hertz, settle_s + WINDOW_S)
            rows = experiment(with_reference(variant, EXCITED), len(samples) / rate_hz, samples)
            runs.append(Run(config, hertz, rows[round(HOLD_S * rate_hz) :], round(settle_s * rate_hz), rate_hz))
    return runs


def path_error(configuration: Configuration, experiment: Experiment, axis: str) -> tuple[float, float]:
    """Rms (um) of reference minus stage on a slow sine, outer loop closed, and that sine's amplitude (um)."""
    settings, index = configuration.axes[axis], list(configuration.axes).index(axis)
    low, high = settings.setpoint.range_um
    amplitude_um = min(_PATH_UM, _PATH_SHARE * (high - low))
    hertz = min(settings.accept.frequencies_Hz)
    samples = _wave(configuration, index, 0.0, amplitude_um, hertz, max(_PATH_S, 2.0 / hertz))
    rows = play(alone(configuration, axis, "stage"), experiment, samples)[:, index]
    late = rows[len(rows) // 2 :]
    return float(np.sqrt(np.mean((late["reference_um"] - late["stage_um"]) ** 2))), amplitude_um


def _wave(configuration: Configuration, index: int, middle: float, size: float, hertz: float, seconds: float) -> Array:
    """At rest at first, then the sine; the others parked."""
    rate_hz = configuration.loop.rate_hz
    t = np.arange(round((HOLD_S + seconds) * rate_hz)) / rate_hz - HOLD_S
    samples = parked(configuration, len(t))
    samples[:, index] = middle + np.where(t > 0.0, size * np.sin(2 * np.pi * hertz * t), 0.0)
    return samples
