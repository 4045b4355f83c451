"""The error budget of an axis: causes with their variances, the whole, the bound, and the whole with other sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

from ...report.model import Curve, Plot, Section, Table

TITLE = "What the path error is made of"


def composition(budget: AxisBudget) -> Section:
    """Causes, bound and other sensors as tables, and the variance summed up over frequency as a plot."""
    told = budget.document()
    causes = tuple(
        (each["name"], f"{each['rms_um']:.3f} um", percent(each["share_percent"]), each["how"])
        for each in told["causes"]
    )
    share = percent(budget.share_percent(budget.variance_um2))
    rows = (*causes, (budget.sum_name, f"{budget.rms_um:.3f} um", share, ""))
    tables = [Table(f"Path error of axis {budget.axis} by cause", ("Cause", "rms", "Share", "How"), rows)]
    if budget.variants:
        others = tuple((each.what, f"{each.rms_um:.3f} um") for each in budget.variants)
        named = ("With", f"{budget.sum_name.capitalize()}, rms")
        tables.append(Table(f"Axis {budget.axis}: what it would be", named, others))
    text = " ".join(
        [
            "Variances of causes that know nothing of each other add up (docs/analyse.md).",
            *(f"{note[0].upper()}{note[1:]}." for note in budget.notes),
            *(f"Not known: {each}." for each in budget.unknown),
        ]
    )
    return Section(TITLE, text, _bound(budget), (summed_up(budget),), tuple(tables))


def _bound(budget: AxisBudget) -> dict[str, str]:
    bound = budget.bound
    if bound is None:
        return {}
    figures = {
        f"causal bound, phases known for {bound.coherence_s:g} s": f"{bound.rms_um:.3f} um",
        "the path's share of the bound": f"{np.sqrt(bound.path_um2):.3f} um",
        "the force's share of it": f"{np.sqrt(bound.force_um2):.3f} um",
    }
    if bound.rms_um > 0.0:
        figures["this one leaves"] = f"{budget.rms_um / bound.rms_um:.1f} times that"
    return figures


def summed_up(budget: AxisBudget) -> Plot:
    """Variance below each frequency: a line is a step, noise a slope."""
    hertz = budget.hertz
    shown = budget.told_apart()
    curves = [Curve(budget.sum_name, hertz, np.cumsum(np.sum([cause.power for cause in budget.causes], axis=0)))]
    curves += [Curve(cause.name, hertz, np.cumsum(cause.power)) for cause in shown]
    if budget.bound is not None:
        ends = hertz[[0, -1]]
        curves.append(Curve("bound", ends, np.full(2, budget.bound.rms_um**2)))
    return Plot(
        "Variance of the path error below a frequency",
        "frequency, Hz",
        "um^2",
        tuple(curves),
        "A sine is a step, noise a slope; where the whole rises is where there is something to gain.",
        log_x=True,
    )


# A controller that knows the spectrum of what comes, path or force, sees it in samples ``s_i = x(t_i) + n_i`` and moves
# the stage a dead time later: at best it moves it to the conditional mean of x then. What is left is
#
#     var = r(0) - k' (K + s^2 I)^-1 k,   K_ij = r(t_i - t_j),   k_i = r(t - t_i)
#
# (Wiener's prediction for a memory of some length; Rasmussen and Williams, Gaussian Processes, equation (2.26)). r is
# the autocovariance of sines whose phase nobody knows for longer than a coherence time, ``A^2/2 cos(w t) exp(-(t/c)^2 /
# 2)``: a pure sine could be learnt for ever, and the bound would be nothing. It assumes that the process is Gaussian
# and the actuator has no other limit than its dead time; what the gauges tell of the force is neglected.

_MEMORY = 3.0
"""Coherence times that the samples go back."""
_MOST = 1500
"""Samples that are looked at."""


def autocovariance(hertz: Array, power: Array, coherence_s: float, step_s: float, count: int, after_s: Array) -> Array:
    """The function r (count, m), um^2, of sines of `hertz` (k,) and `power` (k,), at lags from `after_s` (m,) on.

    The phase at a lag is that of its block of lags and that within it: few are computed, the rest is a product.
    """
    some = power > 1e-12 * power.max(initial=0.0)
    omega = 2.0 * np.pi * hertz[some]
    block = int(np.ceil(np.sqrt(count)))
    within, blocks = (np.exp(1j * np.outer(each * step_s * np.arange(block), omega)) for each in (1, block))
    found = [((blocks * (power[some] * np.exp(1j * omega * after))) @ within.T).real.ravel() for after in after_s]
    lags_s = step_s * np.arange(count)[:, None] + after_s
    return np.asarray(np.array(found).T[:count] * np.exp(-0.5 * (lags_s / coherence_s) ** 2))


def prediction_variance(
    hertz: Array, power: Array, coherence_s: float, noise_variance: float, step_s: float, ahead_s: Array
) -> float:
    """Mean over `ahead_s` (m,) of the variance (um^2) that is left of a prediction so far beyond the newest sample."""
    count = int(min(_MOST, max(2.0, _MEMORY * coherence_s / step_s)))
    found = autocovariance(hertz, power, coherence_s, step_s, count, np.append(0.0, ahead_s))
    row, asked = found[:, 0], found[:, 1:]
    row[0] += noise_variance
    known = np.sum(asked * solve_toeplitz(row, asked), axis=0)
    return float(max(np.mean(float(np.sum(power)) - known), 0.0))


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
