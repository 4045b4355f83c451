"""The outer loop from the boldest design down: the first that is measured as predicted, and that rests, is taken."""

from __future__ import annotations

from dataclasses import dataclass, replace

from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration

from ..actuation import Actuator
from ..experiment import Experiment, with_axis
from ..sensitivity import Sensitivity
from ..synthesis import OuterDesign
from ..tuning import StageModel
from .closing import Say, close_outer
from .knobs import Knobs
from .limit_cycle import Held
from .validation import Validation, validate

_RUNGS, _CALMER = 3, 0.5
"""Designs that are closed at most, and the bandwidth of each in terms of the one before."""


@dataclass(frozen=True)
class ClosedOuter:
    """The outer loop of an axis: the stage's model, the design, the loop as measured, what fresh experiments say."""

    stage: StageModel
    design: OuterDesign
    loop: Sensitivity
    validation: Validation


def prove_outer(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    actuator: Actuator,
    stage: StageModel,
    knobs: Knobs,
    inner: Held,
    seed: int,
    say: Say,
    learned: list[str],
) -> ClosedOuter:
    """The boldest outer loop that is proven around the strain loop; `inner` is the axis in that alone, at rest.

    Raises CheckFailed where none is, with why each was not.
    """
    reasons: list[str] = []
    for _ in range(_RUNGS):
        try:
            model, designed, loop = close_outer(
                configuration, experiment, axis, actuator, stage, knobs, seed, say, learned
            )
        except CheckFailed as problem:
            reasons.append(str(problem).removeprefix(f"axis {axis}: "))
            break
        if loop.as_predicted:
            say("validation")
            check = validate(with_axis(configuration, axis, outer=designed.outer), experiment, axis, inner)
            if not check.rest.swings:
                return ClosedOuter(model, designed, loop, check)
            reason = f"it swings at rest: {check.rest.told}"
        else:
            reason = f"it is not what was predicted: {loop.sentence}"
        reasons.append(f"at {designed.bandwidth_Hz:.3g} Hz {reason}")
        learned.append(f"outer loop {reasons[-1]}")
        knobs = replace(knobs, bandwidth_Hz=_CALMER * designed.bandwidth_Hz)
    raise CheckFailed("; ".join(reasons))
