"""Which outer loops the drawn plants bear."""

from __future__ import annotations

from micromanip.control.margins import sensitivity
from micromanip.control.outer_gains import OuterGains
from micromanip.control.stage_loop import stage_loop
from micromanip.design.analyse.loops import HELD_SENSITIVITY, StrainSide, draw, drawn_plant, held_plant
from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import LinearModel, Outer

from ..identify.actuation import Actuator

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
        actuator: Actuator,
        period_s: float,
        accept: Accept,
        slopes: tuple[float, ...],
    ) -> None:
        self._at_slopes = [held_plant(slope, strain, model, period_s) for slope in slopes if slope != 1.0]
        drawn = [drawn_plant(draw(seed), strain, model, period_s) for seed in DRAWN]
        self._without_inverse = sum(plant is None for plant in drawn)
        self._plants = [plant for plant in drawn if plant is not None]
        self._order = list(range(len(self._plants)))
        self._late = actuator.path.stage_late
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
