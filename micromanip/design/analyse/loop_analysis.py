"""The parts of an axis that an analysis looks at one by one: its inverse, its strain loop, its outer loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from micromanip.control.margins import Margins, Unsure, grid, margins, refined, within
from micromanip.control.outer_gains import outer_gains
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import Array, System
from micromanip.design.analyse.describing import limit_cycles, sweep
from micromanip.design.analyse.loops import SPREAD, StageSide, StrainSide, held_plant, over_path, strain_loop
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.reference import AxisTracker

from ..identify.actuation import Actuator
from .describing import (
    LimitCycle,
    Sweep,
    Verdict,
    actuator_operator,
    amplitudes_up_to,
    branch_slopes,
    gain_map,
    harmonics,
    inverse_operator,
    judge,
)
from .saturation import Reach, Samples, comes_to_rest
from .sensitivity import SMALL_HZ

SLOPES, _APART = (0.75, 1.0, 1.3), 1.35
"""Multiples of the identified slope for which margins must hold in any case: amplitude, place, ageing; and how far
apart, at most, those are that margins are taken at."""
_ADDED = 1.15
"""What creep, a lag of the hysteresis, and the other frequencies of a multisine, may still add there."""
_AMPLITUDES = 200


@dataclass(frozen=True)
class Inverse:
    """Describing function of the inverse over the set-points: figure 7, the verdict on its map."""

    thresholds_um: Array
    swept: Sweep
    verdict: Verdict


@dataclass(frozen=True)
class Strain:
    """The strain loop for the slopes (multiples of the identified one) that the describing function allows."""

    actuator: Actuator
    side: StrainSide
    slopes: tuple[float, ...]
    loops: tuple[System, ...]
    margins: tuple[Margins, ...]
    cycles: tuple[LimitCycle, ...]


@dataclass(frozen=True)
class Stage:
    """The whole outer loop around its model; limit cycles where the inverse does not fit the actuator.

    `margins` are the worst within what is known of the plant, at the slope of 1, too.
    `at_slopes`: multiples of the actuator's slope with the margins there, the feedforward held at its own slope, as an
    inverse would be that does not fit. `rests`: a swing of any size dies out although the set-point's slew is limited.
    """

    side: StageSide
    loop: System
    margins: Margins
    cycles: tuple[LimitCycle, ...]
    rests: bool
    at_slopes: tuple[tuple[float, Margins], ...] = ()


def analyse_inverse(model: PrandtlIshlinskii, settings: Axis) -> Inverse:
    """Figure 7 about the axis' working point, and the map and verdict over its set-points."""
    return _inverse(model, *settings.setpoint.range_um, settings.centre_um)


@lru_cache(maxsize=8)  # each loop that is closed, and the analysis after it, asks for the same
def _inverse(model: PrandtlIshlinskii, low: float, high: float, centre_um: float) -> Inverse:
    thresholds = inverse_operator(model).thresholds
    room = min(centre_um - low, high - centre_um)
    # a working point at the end of the range has no room: then the middle
    offset, room = (centre_um, room) if room > 0 else (0.5 * (low + high), 0.5 * (high - low))
    swept = sweep(model, offset, amplitudes_up_to(room, thresholds, _AMPLITUDES))
    return Inverse(thresholds, swept, judge(model, (low, high), gain_map(model, (low, high))))


def small_slope(dynamics: System) -> float:
    """Slope (um/V) that an actuator's response shows, for the small swing that it was measured with."""
    return float(np.abs(dynamics.response(np.array([2.0 * np.pi * SMALL_HZ]))[0]))


def slopes_of(
    settings: Axis, swing_um: float, inverse: Inverse | None, seen_um_per_V: float, branch_um_per_V: float = 0.0
) -> tuple[float, tuple[float, ...]]:
    """Slope (um/V) of the hysteresis model for a swing about the centre; and the slopes that margins must hold for.

    These are multiples of the identified one, rising: the flattest and the steepest of `SLOPES`, the model's map and
    branches and a branch as recorded, `branch_um_per_V`; 1; and some between, as `between` says.
    A model of another class than the actuator may make small swings too flat, and the steepest too many times as steep
    by that: where the response shows more, `seen_um_per_V`, the steepest is a multiple of what was seen.
    """
    model = settings.hysteresis if isinstance(settings.hysteresis, PrandtlIshlinskii) else None
    if model is None or inverse is None:
        return 1.0, SLOPES
    identified = 1.0 / abs(harmonics(inverse_operator(model), swing_um, settings.centre_um).gain)
    um_per_V = [1.0 / gain for gain in inverse.verdict.gain_range_V_per_um if np.isfinite(gain)]
    um_per_V += [*branch_slopes(model, settings.setpoint.range_um), *([branch_um_per_V] if branch_um_per_V else [])]
    flattest = min([SLOPES[0], *(slope / identified for slope in um_per_V)])
    steepest = max([SLOPES[-1], *(slope / max(identified, seen_um_per_V / _ADDED) for slope in um_per_V)])
    return identified, between(flattest, steepest)


def between(flattest: float, steepest: float) -> tuple[float, ...]:
    """Slopes from `flattest` by way of 1 to `steepest`, each at most `_APART` times the one before.

    A phase margin is no worse at an end of the range than within it only where nothing resonates.
    """
    below, above = (int(np.ceil(np.log(wide) / np.log(_APART))) for wide in (1.0 / flattest, steepest))
    return *np.geomspace(flattest, 1.0, below + 1).tolist(), *np.geomspace(1.0, steepest, above + 1)[1:].tolist()


def analyse_strain(settings: Axis, actuator: Actuator, inverse: Inverse | None) -> Strain:
    """Margins for the identified slope and the flattest and steepest of the map; limit cycles about the centre."""
    model = settings.hysteresis if isinstance(settings.hysteresis, PrandtlIshlinskii) else None
    seen_um_per_V = small_slope(actuator.dynamics)
    identified, slopes = slopes_of(settings, actuator.swing_um, inverse, seen_um_per_V, actuator.branch_um_per_V)
    seen = over_path(actuator.system, actuator.path)
    loops = tuple(strain_loop(settings.running_inner, seen, slope) for slope in slopes)
    cycles: tuple[LimitCycle, ...] = ()
    if model is not None:
        forward, swing_V = actuator_operator(model), actuator.swing_um / identified
        unit = harmonics(forward, swing_V, actuator.centre_V).gain
        nominal = strain_loop(settings.running_inner, seen)
        amplitudes = np.geomspace(0.1, 100.0, _AMPLITUDES)
        found = _cycles(lambda a: harmonics(forward, a, actuator.centre_V).gain / unit, amplitudes, nominal)
        cycles = tuple(found)
    side = StrainSide(
        settings.running_inner,
        actuator.dynamics,
        model,
        settings.setpoint.range_um,
        max(identified, seen_um_per_V / _ADDED),
        actuator.path,
        actuator.delay,
    )
    return Strain(actuator, side, slopes, loops, tuple(margins(loop) for loop in loops), cycles)


def analyse_stage(
    settings: Axis,
    tracker: AxisTracker | None,
    period_s: float,
    late_cycles: int = 0,
    strain: Strain | None = None,
    unsure: Unsure = np.zeros_like,
) -> Stage:
    """Margins of the loop broken at the set-point; limit cycles with an inverse that is wrong by ``SPREAD``.

    With the `strain` loop that it is around, the margins at its slopes, too. `unsure`: how well the stage's response is
    known, as a share of it; the margins are the worst within.
    """
    outer = settings.outer
    if outer is None:
        raise ValueError("the axis has no section outer")
    gains = outer_gains(outer, tracker, period_s)
    loop = stage_loop(gains, model_system(outer.model, period_s), outer.sample_cycles, late_cycles)
    cycles: list[LimitCycle] = []
    if isinstance(settings.hysteresis, PrandtlIshlinskii) and settings.inner.mode != "pid":
        low, high = settings.setpoint.range_um
        amplitudes = np.geomspace(0.1, 0.5 * (high - low), _AMPLITUDES)
        for mismatch in mismatches(settings.hysteresis, 0.5 * (low + high)):
            cycles += _cycles(mismatch, amplitudes, loop)
    side = StageSide(gains, outer.model, outer.sample_cycles, late_cycles)
    samples, alone = Samples(outer.sample_cycles, late_cycles), outer_gains(outer, None, period_s)
    rests = comes_to_rest(alone, len(outer.model.A), Reach.of(settings, period_s), period_s, samples)
    known = within(margins(loop), loop, unsure)
    at_slopes: tuple[tuple[float, Margins], ...] = ()
    if strain is not None:
        plants = [(slope, held_plant(slope, strain.side, outer.model, period_s)) for slope in strain.slopes]
        loops = [(slope, stage_loop(gains, plant, outer.sample_cycles, late_cycles)) for slope, plant in plants]
        at_slopes = tuple((slope, known if slope == 1.0 else margins(each)) for slope, each in loops)
    return Stage(side, loop, known, tuple(cycles), rests, at_slopes)


def mismatches(model: PrandtlIshlinskii, offset_um: float) -> list[Callable[[float], complex]]:
    """Describing functions of inverse and actuator in series, over the set-point's amplitude (um), nominally 1.

    The actuator's gain and its hysteresis are wrong by ``SPREAD``, all four corners: a real actuator's response, over
    that of the model, to the voltage that the inverse gives.
    """
    inverse, forward = inverse_operator(model), actuator_operator(model)

    def corner(gain: float, hysteresis: float) -> Callable[[float], complex]:
        weights = tuple(hysteresis * w for w in model.weights)
        real = actuator_operator(model.model_copy(update={"weights": weights}))

        def mismatch(amplitude_um: float) -> complex:
            asked = harmonics(inverse, amplitude_um, offset_um)
            if not np.isfinite(asked.v0):
                return complex(np.nan, np.nan)
            swing_V = amplitude_um * abs(asked.gain)
            return gain * harmonics(real, swing_V, asked.v0).gain / harmonics(forward, swing_V, asked.v0).gain

        return mismatch

    g, h = SPREAD.piezo_gain, SPREAD.hysteresis_gain
    return [corner(1.0 + a * g, 1.0 + b * h) for a in (-1, 1) for b in (-1, 1)]


def _cycles(gain: Callable[[float], complex], amplitudes: Array, loop: System) -> list[LimitCycle]:
    omega, _ = refined(loop.response, grid(loop.period_s, loop.poles))
    return limit_cycles(gain, amplitudes, loop.response, omega)
