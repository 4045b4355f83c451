"""The step of the stage by which an outer loop is designed and judged: 5 um in 10 ms, as a path moves, not a jump.

It goes the way of every played reference: position and velocity through the regulator's feedforward. In the model the
Kalman filter knows the state, so that the answer is that of the state feedback alone, whatever the filter's speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from micromanip.control.outer_gains import OuterGains
from micromanip.control.system import Array

STEP_UM, RISE_S = 5.0, 0.01
"""Small enough that neither set-point nor voltage meets a limit: it is the linear loop that is looked at."""
_SETTLED_SHARE, _NOISES = 0.05, 4.0


@dataclass(frozen=True)
class StepAnswer:
    """Of the stage: `overshoot` as a share of the step, `settling_s` until it stays within `band_um`."""

    overshoot: float
    settling_s: float
    band_um: float


def course(t_s: Array) -> Array:
    """Reference (um) at times (n,) after the step's beginning."""
    return np.asarray(STEP_UM * (0.5 - 0.5 * np.cos(np.pi * np.clip(t_s / RISE_S, 0.0, 1.0))))


def judge_step(t_s: Array, stage_um: Array, noise_um: float = 0.0) -> StepAnswer:
    """From the stage (n,) at times (n,) about the step; what 4 times the noise may do is not counted."""
    after = t_s >= 0.0
    overshoot = max(0.0, float(stage_um[after].max() - STEP_UM) - _NOISES * noise_um) / STEP_UM
    band_um = max(_SETTLED_SHARE * STEP_UM, _NOISES * noise_um)
    outside = np.flatnonzero((np.abs(stage_um - STEP_UM) > band_um) & after)
    return StepAnswer(overshoot, float(t_s[outside[-1]]) if len(outside) else 0.0, band_um)


def predicted_step(gains: OuterGains, controllable: int, period_s: float, seconds: float) -> StepAnswer:
    """By the model, whose first `controllable` states the regulator moves."""
    t_s = np.asarray(np.arange(round(seconds / period_s)) * period_s, dtype=np.float64)
    position = course(t_s)
    fed = gains.reference[0] * position + gains.reference[1] * np.gradient(position, period_s)
    A, B = gains.A[:controllable, :controllable], gains.B[:controllable]
    closed = A - np.outer(B, gains.feedback[:controllable])
    # C closed^k for all cycles k, twice as many each time: a product for each cycle takes twenty times as long
    rows, power = gains.C[None, :controllable], closed
    while len(rows) < len(t_s):
        rows, power = np.concatenate([rows, rows @ power]), power @ power
    stage_um = np.concatenate([[0.0], fftconvolve(rows[: len(t_s)] @ B, fed)[: len(t_s) - 1]])
    return judge_step(t_s, stage_um)
