"""The outer loop by two human knobs: how fast (bandwidth), and how noisy the capacitive sensor is.

The LQG of `control/outer_gains.py` has five figures; along one line through them everything that matters
changes together, from calm to fast: the smaller the control weight, the more disturbance is expected. The line is
that of three designs that were tried on the plant (control weight 30, 10, 3 with a random walk of 0.03, 0.1,
0.3 um a cycle).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.control.margins import grid, margins, refined
from micromanip.control.outer_gains import OuterGains, outer_gains
from micromanip.design.loops import stage_loop
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import LinearModel, Outer

from ..loops import Margins, System, model_system

GAIN_DB, PHASE_DEG = 6.0, 35.0
_RESERVE_DB, _RESERVE_DEG = 0.3, 2.0
"""What is asked for beyond the least margins: the next identification gives a slightly other model."""
_CONTROL_WEIGHTS = np.geomspace(1.0, 1000.0, 25)
_BESIDE = 0.1
_WALK, _OSCILLATION = 1.0, 1e-2
"""Random walk times control weight along the line; noise of the tooth-passing oscillator in terms of the walk's."""
_LATE_WALK, _LATE_OSCILLATION = 0.1, 1e-1
"""The same where samples come late: then integral action costs more of the margins than damping does."""


_ROBUST = 3.0


@dataclass(frozen=True)
class OuterDesign:
    """The tuning with its margins; `tried` has (weight, bandwidth_Hz, gain margin dB, phase margin deg) per design."""

    outer: Outer
    margins: Margins
    bandwidth_Hz: float
    tried: tuple[tuple[float, float, float, float], ...]


def _bandwidth_Hz(found: Margins, oscillation_Hz: float | None) -> float:
    """Highest crossover; the oscillator makes two of its own, which say nothing of the rest."""
    own = [f for f in found.crossovers_Hz if oscillation_Hz is None or abs(f / oscillation_Hz - 1.0) > _BESIDE]
    return max(own or found.crossovers_Hz, default=0.0)


def _robust(loop: System, unsure: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> float:
    """Ms wherever within its uncertainty the plant may be."""
    omega, L = refined(loop.response, grid(loop.period_s, loop.poles))
    return float(1.0 / np.maximum(np.abs(1.0 + L) - np.abs(L) * unsure(omega), 1e-3).min())


def _any(_: Outer, __: OuterGains) -> bool:
    return True


def tune_outer(
    model: LinearModel,
    period_s: float,
    noise_um: float,
    *,
    unsure: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
    bears: Callable[[Outer, OuterGains], bool] = _any,
    gain_dB: float = GAIN_DB,
    phase_deg: float = PHASE_DEG,
    bandwidth_Hz: float | None = None,
    oscillation_Hz: float | None = 200.0,
    sample_cycles: int = 1,
    late_cycles: int = 0,
) -> OuterDesign:
    """The fastest outer loop for `model` with at least 6 dB and 35 degrees, or the one of `bandwidth_Hz`.

    `noise_um` is the sensor's rms; `bandwidth_Hz` the highest crossover of the loop; a sample is seen
    `late_cycles` after it was taken. `unsure` gives the uncertainty of the model's response at angular frequencies as a
    share of it: wherever the plant is within, Ms stays below 3. `bears` is asked whether a design that has its margins
    also bears what else it must. Raises CheckFailed where the margins are not to be had, with what is.
    """
    tried: list[tuple[float, float, float, float]] = []
    best: tuple[Outer, Margins, float] | None = None
    fragile = unknown = False
    walking, oscillating = (_LATE_WALK, _LATE_OSCILLATION) if late_cycles else (_WALK, _OSCILLATION)
    for weight in _CONTROL_WEIGHTS:
        walk = walking / weight
        outer = Outer(
            model=model,
            control_weight=float(f"{weight:.4g}"),
            disturbance_um=float(f"{walk:.4g}"),
            oscillation_Hz=oscillation_Hz,
            oscillation_um=float(f"{oscillating * walk:.4g}"),
            sensor_noise_um=float(f"{max(noise_um, 1e-4):.3g}"),
            sample_cycles=sample_cycles,
        )
        gains = outer_gains(outer, None, period_s)
        loop = stage_loop(gains, model_system(model, period_s), sample_cycles, late_cycles)
        found = margins(loop)
        crossover = _bandwidth_Hz(found, oscillation_Hz)
        tried.append((float(weight), crossover, found.gain_dB, found.phase_deg))
        if not found.stable or found.gain_dB < gain_dB + _RESERVE_DB or found.phase_deg < phase_deg + _RESERVE_DEG:
            continue
        if best is not None and (bandwidth_Hz is None or abs(crossover - bandwidth_Hz) >= abs(best[2] - bandwidth_Hz)):
            continue
        if unsure is not None and _robust(loop, unsure) > _ROBUST:
            unknown = True
            continue
        if not bears(outer, gains):
            fragile = True
            continue
        if best is None or (bandwidth_Hz is not None and abs(crossover - bandwidth_Hz) < abs(best[2] - bandwidth_Hz)):
            best = outer, found, crossover
    if best is None or (bandwidth_Hz is not None and best[2] < 0.8 * bandwidth_Hz):
        if unknown and bandwidth_Hz is None:
            raise CheckFailed(
                f"outer loops have their margins around the model, but Ms is above {_ROBUST:g} somewhere within what "
                "the measured response leaves open: measure with less noise, or ask for a calmer loop with --noise"
            )
        closest = max(tried, key=lambda entry: min(entry[2] - gain_dB, (entry[3] - phase_deg) / 6.0))
        if fragile and bandwidth_Hz is None:
            raise CheckFailed(
                "outer loops have their margins around the model, but not over the plants drawn around it: more "
                "damping of the flexure's mode, or less delay, would help; or allow more in accept.robust_sensitivity"
            )
        asked = "" if bandwidth_Hz is None else f" at {bandwidth_Hz:g} Hz"
        raise CheckFailed(
            f"no outer loop{asked} has margins of {gain_dB:g} dB and {phase_deg:g} deg; the best has "
            f"{closest[2]:.1f} dB and {closest[3]:.0f} deg at {closest[1]:.0f} Hz: ask for less bandwidth, or identify "
            "the model again"
        )
    return OuterDesign(best[0], best[1], best[2], tuple(tried))
