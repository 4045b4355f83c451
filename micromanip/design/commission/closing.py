"""A loop of an axis closed: tuned, measured, and once more from that where it is not as predicted; or a calmer one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from micromanip.control.margins import sensitivity
from micromanip.control.outer_gains import OuterGains, outer_gains
from micromanip.control.stage_loop import stage_loop
from micromanip.errors import CheckFailed
from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import Axis, LinearModel, Outer
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE

from ..analyse.loop_analysis import Inverse, analyse_inverse, analyse_strain, between, slopes_of, small_slope
from ..analyse.loops import HELD_SENSITIVITY, StrainSide, draw, drawn_plant, held_plant, over_path, strain_loop
from ..analyse.sensitivity import Sensitivity, judge_loop, kept
from ..experiment import Experiment, with_axis
from ..identify.actuation import DELAYS, ORDERS, Actuator
from ..identify.closed_loop_response import measure_outer_loop, measure_strain_loop
from ..identify.models import StageModel, with_response
from ..identify.response import Wanted, identify
from ..synthesise import OuterDesign, PidDesign, Reach, tune_outer, tune_pid
from .guarded_experiment import Say
from .limit_cycle import Held
from .prices import Price, outer_prices, strain_prices
from .validation import Validation, validate

BUS_SLOPE = 1.45
"""The PID holds its margins up to this multiple of the actuator's slope where the samples of a bus show less of it."""


@dataclass(frozen=True)
class Options:
    """What a human may ask of a commissioning; None leaves a figure to the margins and to what was measured."""

    bandwidth_Hz: float | None = None
    noise_um: float | None = None
    tooth_Hz: float | None = None
    """Tooth-passing frequency that the outer loop cancels; None leaves it to the axis' own section `outer`."""
    tooth_seen_Hz: float | None = None
    """The one that was seen, for an axis without that section; None: nothing is cancelled, unless it sees one."""

    def tooth(self, settings: Axis) -> float | None:
        """Tooth-passing frequency (Hz) that the outer loop of an axis with these settings is to cancel."""
        if self.tooth_Hz is not None:
            return self.tooth_Hz
        return settings.outer.oscillation_Hz if settings.outer else self.tooth_seen_Hz


@dataclass(frozen=True)
class Bench:
    """An `axis` of `configuration`, as far as it is tuned, and what it is measured by.

    `learned` takes what was found wanting and done again, in sentences.
    """

    configuration: Configuration
    experiment: Experiment
    axis: str
    seed: int
    say: Say
    learned: list[str]

    @property
    def settings(self) -> Axis:
        """Of the axis."""
        return self.configuration.axes[self.axis]

    @property
    def period_s(self) -> float:
        """Of a cycle."""
        return self.configuration.loop.period_ns * 1e-9

    @property
    def inverse(self) -> Inverse:
        """Describing function of the model that runs."""
        hysteresis = self.settings.hysteresis
        assert isinstance(hysteresis, PrandtlIshlinskii)
        return analyse_inverse(hysteresis, self.settings)


def close_strain(
    bench: Bench, actuator: Actuator, noise_um: float, left_um: float
) -> tuple[Actuator, PidDesign, Sensitivity, tuple[Price, ...]]:
    """PID for `actuator`, closed, and measured; once more from what was measured where it is not what was predicted.

    And what more bandwidth would cost. The gauge has `noise_um` rms, the inverse leaves `left_um` over.
    """
    settings, by_bus = bench.settings, actuator.path != AT_ONCE
    for again in (False, True):
        seen = over_path(actuator.system, actuator.path)
        seen_um_per_V, branch_um_per_V = small_slope(actuator.dynamics), actuator.branch_um_per_V
        _, slopes = slopes_of(settings, actuator.swing_um, bench.inverse, seen_um_per_V, branch_um_per_V)
        if by_bus:
            slopes = between(slopes[0], max(slopes[-1], BUS_SLOPE))
        tune = partial(
            tune_pid,
            settings.inner,
            careful=by_bus,
            gain_dB=settings.accept.gain_margin_dB,
            phase_deg=settings.accept.phase_margin_deg,
        )
        given: dict[str, Any] = {
            "actuator": seen,
            "slopes": slopes,
            "radius": None if by_bus else actuator.found.radius_at,
            "residual": float(np.clip(noise_um / max(left_um, 1e-6), 0.03, 0.5)),
        }
        pid = tune(**given)
        bench.say("sensitivity of the strain loop")
        closed = with_axis(bench.configuration, bench.axis, inner=pid.inner)
        measured = measure_strain_loop(closed, bench.experiment, bench.axis, bench.seed + 10 + again)
        nominal = pid.margins[slopes.index(1.0)]
        loop = judge_loop("strain loop", measured, actuator.system, strain_loop(pid.inner, seen), nominal)
        if by_bus or (loop.agrees and (again or kept(loop.at_slopes(slopes), pid.margins))):
            return actuator, pid, loop, strain_prices(tune, given, actuator, pid)
        bench.learned.append(loop.sentence)
        actuator = replace(actuator, found=identify(measured, bench.period_s, Wanted(ORDERS, DELAYS)))
    raise CheckFailed(
        f"axis {bench.axis}: the tuning is withdrawn, the strain loop is not what was predicted: "
        f"{'; '.join(bench.learned)}. {pid.limited_by[0].upper()}{pid.limited_by[1:]}"
    )


DRAWN = range(1, 21)
"""Seeds of the plants on which the tuning is tried on paper."""
_SLOPES_KEEP = 0.97
"""Of what is allowed at the slopes: the next identification gives slightly others."""
_QUANTILE_KNOWN = 0.8
"""Of Ms as accepted: what the twenty must keep, so that the hundred of `analyse margins` keep it, too."""


class Borne:
    """Whether an outer loop around `model` keeps Ms at every slope of the hysteresis, for enough of the drawn plants.

    The hardest of these is asked first.
    """

    def __init__(
        self,
        model: LinearModel,
        strain: StrainSide,
        late_cycles: int,
        period_s: float,
        accept: Accept,
        slopes: tuple[float, ...],
    ) -> None:
        self._at_slopes = [held_plant(slope, strain, model, period_s) for slope in slopes if slope != 1.0]
        drawn = [drawn_plant(draw(seed), strain, model, period_s) for seed in DRAWN]
        self._without_inverse = sum(plant is None for plant in drawn)
        self._plants = [plant for plant in drawn if plant is not None]
        self._order = list(range(len(self._plants)))
        self._late = late_cycles
        self._too_many = int((1.0 - 0.01 * accept.robust_percent) * len(DRAWN) + 1e-9) + 1
        self._most = _QUANTILE_KNOWN * accept.robust_sensitivity

    def __call__(self, outer: Outer, gains: OuterGains) -> bool:
        for plant in self._at_slopes:
            loop = stage_loop(gains, plant, outer.sample_cycles, self._late)
            if sensitivity(loop) > _SLOPES_KEEP * HELD_SENSITIVITY:
                return False
        hard = self._without_inverse
        for k in tuple(self._order):
            if hard >= self._too_many:
                return False
            if sensitivity(stage_loop(gains, self._plants[k], outer.sample_cycles, self._late)) > self._most:
                hard += 1
                self._order.remove(k)
                self._order.insert(0, k)
        return hard < self._too_many


def close_outer(
    bench: Bench, actuator: Actuator, stage: StageModel, options: Options
) -> tuple[StageModel, OuterDesign, Sensitivity, Callable[[], tuple[Price, ...]]]:
    """The same for the outer loop, at last as it is: whether that will do is for who asks to say.

    What more bandwidth would cost is found out when it is called.

    Raises CheckFailed where no design is to be had.
    """
    settings, period_s, path = bench.settings, bench.period_s, actuator.path
    strain = analyse_strain(settings, actuator, bench.inverse)
    for again in (False, True):
        bench.say("outer loop")
        tune = partial(
            tune_outer,
            stage.linear,
            period_s,
            gain_dB=settings.accept.gain_margin_dB,
            phase_deg=settings.accept.phase_margin_deg,
            overshoot=0.01 * settings.accept.overshoot_percent,
            settling_s=1e-3 * settings.accept.settling_ms,
            bandwidth_Hz=options.bandwidth_Hz,
            oscillation_Hz=options.tooth(settings),
            sample_cycles=path.stage_cycles,
            late_cycles=path.stage_late,
        )
        given: dict[str, Any] = {
            "noise_um": stage.noise_um if options.noise_um is None else options.noise_um,
            "unsure": stage.found.unsure_at,
            "bears": Borne(stage.linear, strain.side, path.stage_late, period_s, settings.accept, strain.slopes),
            "reach": Reach.of(settings, period_s),
        }
        outer = tune(**given)
        bench.say("sensitivity of the outer loop")
        closed = with_axis(bench.configuration, bench.axis, outer=outer.outer)
        measured = measure_outer_loop(closed, bench.experiment, bench.axis, bench.seed + 20 + again)
        gains, plant = outer_gains(outer.outer, None, period_s), stage.found.system()
        closed_loop = stage_loop(gains, plant, path.stage_cycles, path.stage_late)
        loop = judge_loop("outer loop", measured, plant, closed_loop, outer.margins)
        if loop.as_predicted or path.stage_cycles > 1 or path.stage_late > 0 or again:
            break
        bench.learned.append(loop.sentence)
        stage = with_response(stage, measured, period_s)
    return stage, outer, loop, partial(outer_prices, tune, given, outer)


_RUNGS, _CALMER = 3, 0.5
"""Designs that are closed at most, and the bandwidth of each in terms of the one before."""


@dataclass(frozen=True)
class ClosedOuter:
    """The outer loop of an axis: the stage's model, the design, the loop as measured, what fresh experiments say.

    `prices`: what more bandwidth would cost.
    """

    stage: StageModel
    design: OuterDesign
    loop: Sensitivity
    validation: Validation
    prices: tuple[Price, ...]


def prove_outer(bench: Bench, actuator: Actuator, stage: StageModel, options: Options, inner: Held) -> ClosedOuter:
    """The boldest outer loop that is proven around the strain loop; `inner` is the axis in that alone, at rest.

    Raises CheckFailed where none is, with why each was not.
    """
    reasons: list[str] = []
    for _ in range(_RUNGS):
        try:
            model, designed, loop, prices = close_outer(bench, actuator, stage, options)
        except CheckFailed as problem:
            reasons.append(str(problem).removeprefix(f"axis {bench.axis}: "))
            break
        if loop.as_predicted:
            bench.say("validation")
            closed = with_axis(bench.configuration, bench.axis, outer=designed.outer)
            check = validate(closed, bench.experiment, bench.axis, inner)
            if not check.rest.swings:
                return ClosedOuter(model, designed, loop, check, prices())
            reason = f"it swings at rest: {check.rest.told}"
        else:
            reason = f"it is not what was predicted: {loop.sentence}"
        reasons.append(f"at {designed.bandwidth_Hz:.3g} Hz {reason}")
        bench.learned.append(f"outer loop {reasons[-1]}")
        options = replace(options, bandwidth_Hz=_CALMER * designed.bandwidth_Hz)
    raise CheckFailed("; ".join(reasons))
