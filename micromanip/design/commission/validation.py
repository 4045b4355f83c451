"""Fresh experiments with the new tuning: the strain loop's sine, the stage's step, and what the other axes see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import OuterGains, outer_gains
from micromanip.settings.schema.model import Configuration

from ..experiment import Experiment, alone, parked, play, resting
from ..step import StepAnswer, course, judge_step
from .limit_cycle import Held, Rest, stage_at_rest
from .tracking import path_error

Array = NDArray[np.float64]

_BEFORE_S, _AFTER_S = 0.5, 0.5
_MOVE_UM, _MOVE_S = 20.0, 1.0
_SHOWN_S = 0.1


@dataclass(frozen=True)
class Validation:
    """`step` (t_s, reference_um, stage_um) of the closed outer loop, and its `answer`.
    `settled_um`: its error at the end, rms; `rest`: the stage while nothing is asked of it.
    `path_um`: rms error on a sine of `path_amplitude_um`.

    `rejected`: (t_s, open_um, closed_um), the model's stage under a step of 1 um of disturbance at the set-point.
    """

    step: tuple[Array, Array, Array]
    answer: StepAnswer
    settled_um: float
    rest: Rest
    path_um: float
    path_amplitude_um: float
    rejected: tuple[Array, Array, Array]


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
    return Validation(
        step,
        answer,
        settled,
        rest,
        path_um,
        amplitude_um,
        rejection(configuration, axis),
    )


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


def rejection(configuration: Configuration, axis: str) -> tuple[Array, Array, Array]:
    """By the model, the stage (um) under a disturbance step of 1 um at the set-point: t_s, without, with outer loop."""
    outer, period_s = configuration.axes[axis].outer, configuration.loop.period_ns * 1e-9
    if outer is None:
        raise ValueError(f"axis {axis} has no outer loop")
    gains, count = outer_gains(outer, None, period_s), round(_SHOWN_S / period_s)
    t_s = np.asarray(np.arange(count) * period_s, dtype=np.float64)
    return t_s, _run(gains, count, closed=False), _run(gains, count, closed=True)


def _run(gains: OuterGains, count: int, *, closed: bool) -> Array:
    controllable = len(gains.A) - int(np.count_nonzero(np.isclose(np.abs(np.linalg.eigvals(gains.A)), 1.0, atol=1e-9)))
    plant, estimate, y = np.zeros(len(gains.A)), np.zeros(len(gains.A)), np.zeros(count)
    plant[controllable] = 1.0
    for k in range(count):
        y[k] = gains.C @ plant
        estimate = estimate + gains.observer * (y[k] - gains.C @ estimate)
        u = -float(gains.feedback @ estimate) if closed else 0.0
        plant, estimate = gains.A @ plant + gains.B * u, gains.A @ estimate + gains.B * u
    return y
