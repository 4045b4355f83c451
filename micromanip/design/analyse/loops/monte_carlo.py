"""Margins of both loops for plants drawn around the nominal one, in parallel through joblib.

A sample is known by its seed: the same seed gives the same plant whatever else is drawn, on any worker. Run inside
``design.parallel.scheduler``, the samples go to a Dask cluster.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from micromanip.control.margins import Margins, margins
from micromanip.control.outer_gains import OuterGains
from micromanip.control.stage_loop import stage_loop
from micromanip.control.system import System, delay
from micromanip.settings.schema.axis import Inner, LinearModel
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

from ...parallel import each
from ..describing import harmonics, inverse_operator
from .perturbation import Perturbation, draw, model_dynamics, perturbed, perturbed_delay, shift
from .strain_loop import closed_ratio, over_path, strain_loop

HELD_SENSITIVITY = 4.0
"""Largest Ms of an outer loop at any slope of the hysteresis, the feedforward held: as bad as an inverse can be."""
_SMALLEST_UM = 0.5
_UNSTABLE = Margins(1.0, 1.0, 0.0, np.nan, 0.0, 0.0, np.nan, (), np.inf)


@dataclass(frozen=True)
class StrainSide:
    """What the strain loop is made of: PID, actuator (volts to um), and its hysteresis for the range of slopes."""

    inner: Inner
    actuator: System
    hysteresis: PrandtlIshlinskii | None
    range_um: Range
    identified_slope: float
    path: FeedbackPath = AT_ONCE
    own_delay: int = 0
    """Cycles of the actuator's delay, which its dynamics lack."""

    def slope(self, p: Perturbation) -> float:
        """Slope of the actuator as a multiple of the identified one; nan where its hysteresis has no inverse."""
        if self.hysteresis is None:
            return p.piezo_gain
        weights = tuple(p.hysteresis_gain * w for w in self.hysteresis.weights)
        if self.hysteresis.alpha + np.cumsum(weights).min(initial=0.0) <= 0.0:
            return np.nan
        low, high = self.range_um
        offset = low + p.place * (high - low)
        room = max(min(offset - low, high - offset), 2.0 * _SMALLEST_UM)
        amplitude = _SMALLEST_UM * (room / _SMALLEST_UM) ** p.swing
        operator = inverse_operator(self.hysteresis.model_copy(update={"weights": weights}))
        return p.piezo_gain / (self.identified_slope * abs(harmonics(operator, amplitude, offset).gain))


@dataclass(frozen=True)
class StageSide:
    """What the outer loop is made of: the compensator's gains, and the plant that it was made for."""

    gains: OuterGains
    model: LinearModel
    sample_cycles: int
    late_cycles: int = 0


@dataclass(frozen=True)
class Sample:
    """One plant: its seed, what was drawn, and the margins of the loops that there are."""

    seed: int
    drawn: Perturbation
    strain: Margins | None
    stage: Margins | None

    @property
    def stable(self) -> bool:
        """Every loop that there is, is stable."""
        return all(loop.stable for loop in (self.strain, self.stage) if loop is not None)


def drawn_plant(drawn: Perturbation, strain: StrainSide | None, model: LinearModel, period_s: float) -> System | None:
    """Set-point to stage of a drawn plant; None where its hysteresis has no inverse."""
    dynamics = model_dynamics(model, period_s)
    mechanics = perturbed(dynamics, drawn)
    if strain is not None:
        slope = strain.slope(drawn)
        if not np.isfinite(slope):
            return None
        late = delay(max(0.0, strain.own_delay + drawn.delay_cycles), period_s)
        own, moved = delay(strain.own_delay, period_s), shift(strain.actuator, drawn)
        mechanics = closed_ratio(strain.inner, strain.actuator, moved, late, slope, own).then(dynamics)
    return perturbed_delay(model, drawn, period_s).then(mechanics)


def held_plant(slope: float, strain: StrainSide, model: LinearModel, period_s: float) -> System:
    """Set-point to stage where the actuator's slope is another while the feedforward keeps its own.

    An inverse that fits changes its slope with the actuator, and the loop stays the nominal one; this is the worst that
    one can be which does not.
    """
    own = delay(strain.own_delay, period_s)
    ratio = closed_ratio(strain.inner, strain.actuator, None, own, slope, own)
    return delay(model.delay_cycles, period_s).then(ratio.then(model_dynamics(model, period_s)))


def sample(seed: int, strain: StrainSide | None, stage: StageSide | None, period_s: float) -> Sample:
    """Draw the plant of `seed` and take the margins of its loops."""
    drawn = draw(seed)
    slope = strain.slope(drawn) if strain else 1.0
    if not np.isfinite(slope):
        return Sample(seed, drawn, _UNSTABLE if strain else None, _UNSTABLE if stage else None)
    inner = outer = None
    if strain is not None:
        # a model without a delay of its own has what there is in its states: it can only be added to
        late = delay(max(0.0, strain.own_delay + drawn.delay_cycles), period_s)
        behind = late.then(perturbed(strain.actuator, drawn))
        inner = margins(strain_loop(strain.inner, over_path(behind, strain.path), slope))
    plant = None if stage is None else drawn_plant(drawn, strain, stage.model, period_s)
    if stage is not None and plant is not None:
        outer = margins(stage_loop(stage.gains, plant, stage.sample_cycles, stage.late_cycles))
    return Sample(seed, drawn, inner, outer)


def monte_carlo(
    strain: StrainSide | None, stage: StageSide | None, period_s: float, seeds: range, jobs: int | None = None
) -> Iterator[Sample]:
    """A sample a seed, in the order of the seeds."""
    return each(partial(sample, strain=strain, stage=stage, period_s=period_s), seeds, jobs)


def worst(samples: list[Sample], of_stage: bool) -> Sample:
    """The sample whose outer loop (or strain loop) has the largest Ms; unstable ones before all others."""

    def badness(case: Sample) -> tuple[bool, float]:
        loop = case.stage if of_stage else case.strain
        if loop is None:
            raise ValueError("the samples have no such loop")
        return not loop.stable, loop.radius if not loop.stable else loop.sensitivity

    return max(samples, key=badness)
