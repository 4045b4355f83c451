"""The error budget of an axis: causes with their variances, the whole, and the bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import solve_toeplitz

from micromanip.control.system import Array, Complex

from ...report.model import Curve, Plot, Section, Table

TITLE = "What the path error is made of"


def composition(budget: AxisBudget) -> Section:
    """Causes and bound as a table, and the variance summed up over frequency as a plot."""
    rows = [(each.name, f"{each.rms_um:.3f} um", budget.share(each.variance_um2)) for each in budget.causes]
    rows.append(("whole", f"{budget.rms_um:.3f} um", budget.share(budget.variance_um2)))
    table = Table(f"Path error of axis {budget.axis} by cause", ("Cause", "rms", "Share"), rows)
    text = f"Variances of causes that know nothing of each other add up (docs/analyse.md). Seen in {budget.seen}."
    return Section(TITLE, text, _bound(budget), (summed_up(budget),), (table,))


def _bound(budget: AxisBudget) -> dict[str, str]:
    bound = budget.bound
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
    curves = [Curve("whole", hertz, np.cumsum(np.sum([cause.power for cause in budget.causes], axis=0)))]
    curves += [Curve(cause.name, hertz, np.cumsum(cause.power)) for cause in shown]
    curves.append(Curve("bound", hertz[[0, -1]], np.full(2, budget.bound.rms_um**2)))
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


TRACKER, PREDICTION, FORCE, STAGE = (
    "tracker noise",
    "tracker delay, rate, prediction",
    "force",
    "capacitive sensor noise",
)
EVERYTHING_ELSE = "everything else"
_LEGIBLE = 0.005
"""Share of the whole below which a cause is not told apart in a picture."""


@dataclass(frozen=True)
class Cause:
    """Power (n,) in um^2 over the bins of frequency."""

    name: str
    power: Array

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
class AxisBudget:
    """Causes of one axis over the middles of the bins `hertz` (n,), the largest first; `seen`: in what, in words."""

    axis: str
    hertz: Array
    causes: tuple[Cause, ...]
    bound: Bound
    seen: str

    @property
    def variance_um2(self) -> float:
        """The sum of the causes."""
        return float(sum(cause.variance_um2 for cause in self.causes))

    @property
    def rms_um(self) -> float:
        """Its root."""
        return float(np.sqrt(self.variance_um2))

    def share_percent(self, variance_um2: float) -> float:
        """Share of the whole."""
        return 100.0 * variance_um2 / self.variance_um2 if self.variance_um2 > 0.0 else 0.0

    def share(self, variance_um2: float) -> str:
        """The same in a table."""
        return f"{self.share_percent(variance_um2):.1f} %"

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
                }
                for cause in self.causes
            ],
            "bound": {
                "rms_um": self.bound.rms_um,
                "path_um": float(np.sqrt(self.bound.path_um2)),
                "force_um": float(np.sqrt(self.bound.force_um2)),
                "coherence_s": self.bound.coherence_s,
                "ratio": self.rms_um / self.bound.rms_um if self.bound.rms_um > 0.0 else None,
            },
            "seen": self.seen,
        }


BIN_HZ = 0.5
"""Narrow beside the lightest mode; finer changes nothing."""


@dataclass(frozen=True)
class Grid:
    """Bins of frequency from 0 to half of the loop's rate; `hertz` (n,) are their middles."""

    rate_hz: float

    @cached_property
    def hertz(self) -> Array:
        """Middles of the bins."""
        count = round(0.5 * self.rate_hz / BIN_HZ)
        return np.asarray((np.arange(count) + 0.5) * BIN_HZ)

    @cached_property
    def omega(self) -> Array:
        """The same in rad/s."""
        return np.asarray(2.0 * np.pi * self.hertz)

    def white(self, transfer: Complex, variance: float) -> Array:
        """Power (n,) behind `transfer` (n,) of noise that is white from cycle to cycle."""
        return np.asarray(np.abs(transfer) ** 2 * (variance / len(self.hertz)))

    def binned(self, x: Array) -> Array:
        """Power (n,) of a signal `x` (m,): the sum is its mean square (Parseval)."""
        power = np.abs(np.fft.rfft(x)) ** 2 / len(x) ** 2
        power[1 : len(power) - (len(x) % 2 == 0)] *= 2.0
        place = (np.fft.rfftfreq(len(x), 1.0 / self.rate_hz) / BIN_HZ).astype(int)
        bins = np.minimum(place, len(self.hertz) - 1)
        return np.asarray(np.bincount(bins, weights=power, minlength=len(self.hertz)), dtype=float)


def shared_out(whole: Array, alone: Mapping[str, Array]) -> tuple[Cause, ...]:
    """`whole` (n,) divided in proportion to what each makes `alone` (n,), where that is nothing in equal parts.

    The largest first. Every share is at least 0, and their sum is `whole`, which must not be negative.
    """
    total = np.sum(list(alone.values()), axis=0)
    some = total > 0.0
    causes = [
        Cause(
            name,
            whole * np.where(some, np.divide(power, total, where=some, out=np.zeros_like(total)), 1.0 / len(alone)),
        )
        for name, power in alone.items()
    ]
    return tuple(sorted(causes, key=lambda cause: -cause.variance_um2))
