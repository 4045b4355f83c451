"""One part out of a run: path, error and what was played, on an even grid, without lag.

The error is the path, as the tracker's samples show it at the times when they were taken, less the measured stage.
Noise of the tracker that the loop has followed is in both, and so hardly in the error. What was played is what the loop
recorded of it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from micromanip.errors import CheckFailed
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import DEVIATION_FRESH
from micromanip.settings.schema.axis import HASH_DIGITS

from .zero_phase import filtered, low_pass

Array = NDArray[np.float64]
Column = Callable[[str], NDArray[Any]]
"""A column of the rows by its name, that of the axis where it has one."""

GRID_HZ = 1000.0
"""A memory has about so many values a second."""
_PASSED, _MARGIN_S = 0.25, 0.5
"""Of the grid's rate, where the low pass before it has its corner; what is used beyond both ends, where there is."""
FELT_S = 0.2
"""So long the stage feels what was played; what came before that is over."""
_MOST_MISSED, _MOST_LIMITED = 0.05, 0.001
_LEAST_BEFORE_S, _LEAST_S = 0.5, 2.0


@dataclass(frozen=True)
class Part:
    """One axis during one part, `rate_hz` values (n,) a second, um; `missed` is the share of cycles that were.

    `before_um` (m,) is what was played in the `FELT_S` before it.
    """

    rate_hz: float
    path_um: Array
    error_um: Array
    played_um: Array
    missed: float
    before_um: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def name(self) -> str:
        """What tells it from any other: a hash of its error."""
        return hashlib.sha256(self.error_um.tobytes()).hexdigest()[:HASH_DIGITS]


@dataclass(frozen=True)
class Run:
    """One axis while it tracked under one tuning: a row per cycle (n,) that was run, s and um; `what` names it.

    Samples of the tracker (k,) are those of before as well.
    """

    what: str
    time_s: Array
    period_s: float
    taken_s: Array
    samples_um: Array
    stage_um: Array
    learned_um: Array
    limited: NDArray[np.bool_]

    @classmethod
    def of(cls, what: str, cell: Column, axis: Column, period_s: float, range_V: tuple[float, float]) -> Run:
        """From the columns of `cell` and `axis`: the longest time of tracking. CheckFailed where there is none."""
        state, version, time_ns = cell("state"), cell("version"), cell("time_ns")
        tracking = np.flatnonzero(state == TRACKING)
        if not len(tracking):
            raise CheckFailed(f"{what}: the cell does not track in it: there is nothing to learn from")
        breaks = (np.diff(tracking) > 1) | (np.diff(version[tracking]) != 0)
        rows = max(np.split(tracking, np.flatnonzero(breaks) + 1), key=len)
        seen = slice(0, int(rows[-1]) + 1)
        time_s = np.asarray((time_ns[seen] - time_ns[rows[0]]) * 1e-9, dtype=float)
        age_s = axis("deviation_age_ns")[seen].astype(float) * 1e-9
        fresh = (axis("fresh")[seen].astype(int) & DEVIATION_FRESH) != 0
        voltage = axis("voltage_V")[rows]
        if np.count_nonzero(fresh[rows[0] :]) < 2:
            raise CheckFailed(f"{what}: no samples of the tracker came while it tracked")
        # one sample may come twice over a bus
        taken_s, first = np.unique((time_s - age_s)[fresh], return_index=True)
        return cls(
            what, time_s[rows], period_s, taken_s, axis("deviation_um")[seen][fresh][first],
            axis("stage_um")[rows], axis("learned_um")[rows], (voltage <= range_V[0]) | (voltage >= range_V[1]),
        )  # fmt: skip

    def path(self, time_s: Array) -> Array:
        """The path (n,) at `time_s`, by a cubic through the samples."""
        return np.asarray(CubicSpline(self.taken_s, self.samples_um)(time_s))

    def part(self, begin_s: float, seconds: float) -> Part:
        """The part that begins `begin_s` after tracking has. CheckFailed where it is not whole in here."""
        self._require_whole(begin_s, seconds)
        step = max(1, round(1.0 / (GRID_HZ * self.period_s)))
        rate_hz = 1.0 / (step * self.period_s)
        count, margin = round(seconds * rate_hz), min(_MARGIN_S, begin_s, self.time_s[-1] - begin_s - seconds)
        ahead = int(margin * rate_hz)
        cycles = np.arange(-ahead * step, (count + ahead) * step)
        grid = np.asarray(begin_s + cycles * self.period_s, dtype=np.float64)
        passing = partial(low_pass, corner_hz=_PASSED * rate_hz)

        def thinned(x: Array) -> Array:
            return filtered(x, 1.0 / self.period_s, passing)[::step][: ahead + count]

        # differences first: both sides of them move far while cycles are missed, and they hardly
        seen = (self.path(self.time_s) - self.stage_um, self.learned_um)
        error, played = (thinned(np.interp(grid, self.time_s, each)) for each in seen)
        within = (self.time_s >= begin_s) & (self.time_s < begin_s + seconds)
        missed = 1.0 - np.count_nonzero(within) / round(seconds / self.period_s)
        self._require_good(missed, float(np.mean(self.limited[within])))
        path = thinned(self.path(grid))
        felt = played[max(0, ahead - round(FELT_S * rate_hz)) : ahead]
        return Part(rate_hz, path[ahead:], error[ahead:], played[ahead:], max(0.0, missed), felt)

    def _require_whole(self, begin_s: float, seconds: float) -> None:
        if seconds < _LEAST_S:
            raise CheckFailed(
                f"{self.what}: a part of {seconds:g} s is too short to learn from: {_LEAST_S:g} s at least"
            )
        if begin_s < _LEAST_BEFORE_S:
            raise CheckFailed(
                f"{self.what}: the part begins {begin_s:g} s after tracking has: the loop needs {_LEAST_BEFORE_S:g} s "
                "to have settled"
            )
        if begin_s + seconds > self.time_s[-1] + 1.5 * self.period_s:
            raise CheckFailed(
                f"{self.what}: it tracks for {self.time_s[-1]:.2f} s under one tuning, the part of {seconds:g} s "
                f"begins at {begin_s:g} s: the part was not finished, nothing is learned from it"
            )

    def _require_good(self, missed: float, limited: float) -> None:
        if missed > _MOST_MISSED:
            raise CheckFailed(
                f"{self.what}: {100 * missed:.1f} % of the part's cycles were missed, at most {100 * _MOST_MISSED:g} % "
                "may be: nothing is learned from it"
            )
        if limited > _MOST_LIMITED:
            raise CheckFailed(
                f"{self.what}: the voltage was at an end of its range for {100 * limited:.2g} % of the part: nothing "
                "is learned from it; `micromanip analyse path` says where the path asks for more than there is"
            )
