"""The error budget of an axis: causes with their variances, the whole, the bound, and the whole with other sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMPUTED, MEASURED = "computed", "measured"
EVERYTHING_ELSE = "everything else"
_LEGIBLE = 0.005
"""Share of the whole below which a cause is not told apart in a picture."""


@dataclass(frozen=True)
class Cause:
    """Power (n,) in um^2 over the bins of frequency; `how` says where it comes from."""

    name: str
    power: Array
    how: str = COMPUTED

    @property
    def variance_um2(self) -> float:
        """What it adds to the variance of the path error."""
        return float(self.power.sum())

    @property
    def rms_um(self) -> float:
        """Its root."""
        return float(np.sqrt(self.variance_um2))


@dataclass(frozen=True)
class Bound:
    """Variances (um^2) that no causal controller can go below, and what the path's coherence was taken to be (s)."""

    path_um2: float
    force_um2: float
    coherence_s: float

    @property
    def rms_um(self) -> float:
        """Root of both together."""
        return float(np.sqrt(self.path_um2 + self.force_um2))


@dataclass(frozen=True)
class Variant:
    """What another sensor, or another force, would give: rms (um) of the sum."""

    what: str
    rms_um: float


@dataclass(frozen=True)
class AxisBudget:
    """Causes of one axis over the middles of the bins `hertz` (n,), the largest first.

    The sum of the causes is the whole, unless there is something `unknown`, which says what nothing is known of.
    `measured_um` is the rms in virtual time where it was played and the truth is known.
    """

    axis: str
    hertz: Array
    causes: tuple[Cause, ...]
    bound: Bound | None = None
    variants: tuple[Variant, ...] = ()
    measured_um: float | None = None
    unknown: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    @property
    def sum_name(self) -> str:
        """What the sum of the causes is."""
        return "known" if self.unknown else "whole"

    @property
    def variance_um2(self) -> float:
        """The sum of the causes."""
        return float(sum(cause.variance_um2 for cause in self.causes))

    @property
    def rms_um(self) -> float:
        """Its root."""
        return float(np.sqrt(self.variance_um2))

    def share_percent(self, variance_um2: float) -> float | None:
        """Share of the whole; None where that is not known."""
        whole = self.variance_um2
        return None if self.unknown else 100.0 * variance_um2 / whole if whole > 0.0 else 0.0

    def told_apart(self) -> tuple[Cause, ...]:
        """Causes that a picture can show, the largest first, and all others as one."""
        large = tuple(cause for cause in self.causes if cause.variance_um2 > _LEGIBLE * self.variance_um2)
        rest = [cause.power for cause in self.causes if cause not in large]
        return (*large, Cause(EVERYTHING_ELSE, np.sum(rest, axis=0))) if rest else large

    def document(self) -> dict[str, Any]:
        """As in JSON."""
        return {
            "axis": self.axis,
            "rms_um": self.rms_um,
            "variance_um2": self.variance_um2,
            "causes": [
                {
                    "name": cause.name,
                    "variance_um2": cause.variance_um2,
                    "rms_um": cause.rms_um,
                    "share_percent": self.share_percent(cause.variance_um2),
                    "how": cause.how,
                }
                for cause in self.causes
            ],
            "measured_um": self.measured_um,
            "bound": None
            if self.bound is None
            else {
                "rms_um": self.bound.rms_um,
                "path_um": float(np.sqrt(self.bound.path_um2)),
                "force_um": float(np.sqrt(self.bound.force_um2)),
                "coherence_s": self.bound.coherence_s,
                "ratio": self.rms_um / self.bound.rms_um if self.bound.rms_um > 0.0 else None,
            },
            "variants": [{"what": each.what, "rms_um": each.rms_um} for each in self.variants],
            "unknown": list(self.unknown),
            "notes": list(self.notes),
        }


def percent(share: float | None) -> str:
    """A share in a table; empty where it is not known."""
    return "" if share is None else f"{share:.1f} %"


def ordered(powers: Mapping[str, Array], how: str = COMPUTED) -> tuple[Cause, ...]:
    """Causes out of powers by name, the largest first."""
    causes = [Cause(name, power, how) for name, power in powers.items()]
    return tuple(sorted(causes, key=lambda cause: -cause.variance_um2))
