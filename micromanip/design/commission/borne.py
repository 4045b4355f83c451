"""Which outer loop: one that the drawn plants bear, and calm enough for what is known of the sensor."""

from __future__ import annotations

from collections.abc import Callable

from micromanip.control.margins import sensitivity
from micromanip.control.outer_gains import OuterGains
from micromanip.errors import CheckFailed
from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import Outer

from ..actuation import Actuator
from ..loops import StageSide, StrainSide, draw
from ..loops.monte_carlo import drawn_loop
from ..synthesis import OuterDesign

DRAWN = range(1, 21)
"""Seeds of the plants on which the tuning is tried on paper."""
_QUANTILE_KNOWN = 0.8
"""Of Ms as accepted: what the twenty must keep, so that the hundred of `analyse` keep it, too."""
_NOISES = (1.0, 4.0, 16.0)
"""What the sensor's noise is taken for, in terms of what was measured, one after the other."""


def calmest_needed(
    design: Callable[..., OuterDesign], asked_um: float | None, noise_um: float, learned: list[str]
) -> OuterDesign:
    """The design for the noise that was asked for; else for the sensor's, or more where that trusts it too far."""
    if asked_um is not None:
        return design(noise_um=asked_um)
    for factor in _NOISES[:-1]:
        try:
            return design(noise_um=factor * noise_um)
        except CheckFailed as problem:
            learned.append(f"with {factor:g} times the sensor's noise: {problem}")
    return design(noise_um=_NOISES[-1] * noise_um)


class Borne:
    """Whether an outer loop keeps Ms as accepted for enough of the drawn plants; the hardest are tried first."""

    def __init__(self, strain: StrainSide, actuator: Actuator, period_s: float, accept: Accept) -> None:
        self._strain, self._path, self._period_s, self._accept = strain, actuator.path, period_s, accept
        self._seeds = list(DRAWN)

    def __call__(self, outer: Outer, gains: OuterGains) -> bool:
        side = StageSide(gains, outer.model, outer.sample_cycles, self._path.stage_late)
        too_many = int((1.0 - 0.01 * self._accept.robust_percent) * len(self._seeds) + 1e-9) + 1
        hard = 0
        for seed in tuple(self._seeds):
            loop = drawn_loop(draw(seed), self._strain, side, self._period_s)
            if loop is None or sensitivity(loop) > _QUANTILE_KNOWN * self._accept.robust_sensitivity:
                hard += 1
                self._seeds.remove(seed)
                self._seeds.insert(0, seed)
            if hard >= too_many:
                return False
        return True
