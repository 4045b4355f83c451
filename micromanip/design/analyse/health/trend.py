"""Checks of an axis: which loops one measures, and what many say: whether a figure drifts, where margins go.

A CUSUM that needs no time of learning, with a false-alarm rate that is known: Hawkins, J. Qual. Technol. 19 (1987).

Each value is put beside the mean and the deviation of those before it. For independent normal values of whatever mean
and deviation, Student's t of that, put through its distribution function, is exactly standard normal from the third on,
and what it adds up to is a CUSUM of known run length (Siegmund 1985).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime

import numpy as np
from scipy.optimize import brentq
from scipy.stats import linregress, norm, t

from micromanip.control.system import System
from micromanip.errors import CheckFailed
from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.tuning_hash import tuning_hash
from micromanip.settings.wiring.timing import FeedbackPath

from ...identify.response import Measured
from ..live_margins import judge_running
from ..loops import SPREAD
from .history import FIGURES, MARGINS, Check, PlantFigures, commissioned, plant_figures

ALLOWANCE = 0.5
"""Half of the shift, in deviations, that it is quickest to see."""
_LARGEST, _SIEGMUND = 8.0, 1.166
_FIRST, _STRANGE = 3, 3.0
"""Values before anything is said; deviations beyond which one is judged, but not learned from."""


def average_run_length(limit: float, allowance: float = ALLOWANCE) -> float:
    """Values between two false alarms of one side, without a shift (Siegmund's approximation)."""
    b = limit + _SIEGMUND
    return (math.exp(2 * allowance * b) - 2 * allowance * b - 1) / (2 * allowance**2)


def limit_for(run_length: float, allowance: float = ALLOWANCE) -> float:
    """The limit that one side crosses falsely once in `run_length` values; never below that of 10."""
    return float(brentq(lambda h: average_run_length(h, allowance) - max(run_length, 10.0), 0.0, 50.0))


class Cusum:
    """Two-sided; values are given one after another, and one that crossed a limit goes on standing there."""

    def __init__(self, limit: float, allowance: float = ALLOWANCE) -> None:
        """Nothing seen yet."""
        self._limit, self._allowance = limit, allowance
        self._seen, self._count, self._mean, self._squares = 0, 0, 0.0, 0.0
        self.upper = self.lower = 0.0
        self.crossed: int | None = None
        """Number of the value (from 0) with which a limit was crossed."""

    @property
    def learning(self) -> bool:
        """Whether nothing can be said yet."""
        return self._count < _FIRST

    def add(self, value: float) -> None:
        """Take the next value in."""
        strange = self._count >= _FIRST - 1 and abs(self._judge(value)) > _STRANGE
        self._seen += 1
        if strange:  # or the first of a new mean would widen what the next are judged by
            return
        before, self._count = self._mean, self._count + 1
        self._mean += (value - before) / self._count
        self._squares += (value - before) * (value - self._mean)

    def _judge(self, value: float) -> float:
        """Its score, which the sums have taken."""
        n = self._count
        deviation = math.sqrt(self._squares / (n - 1))
        if deviation == 0.0:
            score = 0.0 if value == self._mean else math.copysign(_LARGEST, value - self._mean)
        else:
            student = math.sqrt(n / (n + 1)) * (value - self._mean) / deviation
            # by its tail: of 1 nothing is left beyond eight deviations
            score = math.copysign(min(float(norm.isf(t.sf(abs(student), n - 1))), _LARGEST), student)
        self.upper = max(0.0, self.upper + score - self._allowance)
        self.lower = max(0.0, self.lower - score - self._allowance)
        if self.crossed is None and max(self.upper, self.lower) > self._limit:
            self.crossed = self._seen
        return score


def change_point(values: Sequence[float]) -> int:
    """Number of the first of `values` after a change of their mean: where it is most likely, if they have one."""
    x = np.asarray(values, dtype=float)
    n = np.arange(1, len(x))
    before, after = np.cumsum(x)[:-1] / n, (x.sum() - np.cumsum(x)[:-1]) / (len(x) - n)
    return int(np.argmax(n * (len(x) - n) * (after - before) ** 2)) + 1


FALSE_ALARMS = 1000.0
"""Checks of an axis between two false alarms, unless asked otherwise."""
_SLOW = math.sqrt((1.0 - SPREAD.stiffness) / (1.0 + SPREAD.stage_mass))
_FAST = math.sqrt((1.0 + SPREAD.stiffness) / (1.0 - SPREAD.stage_mass))
DRAWN = {
    "mode_Hz": (_SLOW, _FAST),
    "mode_damping": (1.0 - SPREAD.damping, 1.0 + SPREAD.damping),
    "actuator_um_per_V": (1.0 - SPREAD.piezo_gain, 1.0 + SPREAD.piezo_gain),
}
"""Shares of the first figure within which plants are drawn when a tuning's robustness is judged."""
_REMEMBERED, _FEWEST, _AHEAD, _SIGNIFICANT = 20, 6, 20, 0.01
"""A margin's slope: over so many checks, of at least so many, looked so many ahead, at that level."""
_AVERAGED, _SURELY, _SURE = 3, 0.95, 2.0
"""Many a tuning was made right up to what is accepted: a margin is below that where its mean is by twice what it is
known to, and by 5 %."""


@dataclass(frozen=True)
class WatchedFigure:
    """A figure: the latest, what it is compared with, and `since` when it drifts (None: it doesn't)."""

    name: str
    latest: float
    before: float
    commissioned: float
    count: int
    learning: bool
    since: datetime | None

    @property
    def change(self) -> float:
        """Share by which the latest is more than before."""
        return self.latest / self.before - 1.0


@dataclass(frozen=True)
class Health:
    """All figures of an axis, and in words what is not as it was; empty where all is."""

    axis: str
    checks: int
    watched: tuple[WatchedFigure, ...]
    problems: tuple[str, ...]


def judge(checks: Sequence[Check], tuned: PlantFigures, accept: Accept, false_alarms: float = FALSE_ALARMS) -> Health:
    """What `checks` of one axis under one tuning, oldest first, say beside the `tuned` figures of its model."""
    watched, latest = [], checks[-1].figures
    known = [name for name in FIGURES if not math.isnan(latest[name])]
    limit = limit_for(2 * len(known) * false_alarms) if known else math.inf
    for name in known:
        seen = [check for check in checks if check.figures[name] > 0.0]
        cusum = Cusum(limit)
        for check in seen:
            cusum.add(math.log(check.figures[name]))
        values = [math.log(check.figures[name]) for check in seen]
        since, until = None, max(len(values) - 1, 1)
        if cusum.crossed is not None:
            until = change_point(values[: cusum.crossed + 1])
            since = seen[until].time
        before = math.exp(float(np.mean(values[:until])))
        watched.append(
            WatchedFigure(name, latest[name], before, getattr(tuned, name), len(values), cusum.learning, since)
        )
    problems = [*_drifts(watched), *_outside(watched, checks), *_margins(checks, accept)]
    return Health(checks[-1].axis, len(checks), tuple(watched), tuple(problems))


def _drifts(watched: Sequence[WatchedFigure]) -> Iterator[str]:
    for each in watched:
        if each.since is not None:
            yield (
                f"{each.name} drifts since {each.since:%Y-%m-%d %H:%M}: {each.before:.4g} before, {each.latest:.4g} "
                f"now ({100 * each.change:+.1f} %)"
            )


def _outside(watched: Sequence[WatchedFigure], checks: Sequence[Check]) -> Iterator[str]:
    for each in watched:
        low, high = DRAWN.get(each.name, (0.0, math.inf))
        known = not math.isnan(each.commissioned)
        origin = each.commissioned if known else checks[0].figures[each.name]
        if not math.isnan(origin) and not low <= each.latest / origin <= high:
            yield (
                f"{each.name} is {each.latest:.4g}, {origin:.4g} {'in the model' if known else 'in the first check'}: "
                f"robustness was judged within {100 * (low - 1):+.0f} to {100 * (high - 1):+.0f} % of it"
            )


def _margins(checks: Sequence[Check], accept: Accept) -> Iterator[str]:
    """Margins that are surely below what is accepted, and those that soon will be."""
    for name, least in _least(accept).items():
        seen = [check.figures[name] for check in checks if not math.isnan(check.figures[name])][-_REMEMBERED:]
        if not seen:
            continue
        averaged = seen[-_AVERAGED:]
        mean = float(np.mean(averaged))
        known = _SURE * checks[-1].deviations.get(name, math.nan)
        if mean < least - np.fmax((1.0 - _SURELY) * least, known / math.sqrt(len(averaged))):
            within = "" if math.isnan(known) else f", known to {known:.2g}"
            over = f", {mean:.3g} on average over {len(averaged)} checks" if len(averaged) > 1 else ""
            yield f"{name} is {seen[-1]:.3g}{within}{over}: at least {least:g} is asked for (`accept`)"
        elif len(seen) >= _FEWEST:
            line = linregress(np.arange(len(seen)), seen, alternative="less")
            now = line.intercept + line.slope * (len(seen) - 1)
            if line.pvalue < _SIGNIFICANT and now + _AHEAD * line.slope < least:
                left = math.ceil((now - least) / -line.slope)
                where = f"some {left} checks away" if left > 0 else "reached"
                yield f"{name} falls by {-line.slope:.2g} a check: its limit, {least:g}, is {where}"


def _least(accept: Accept) -> Mapping[str, float]:
    return {"stage_gain_dB": accept.gain_margin_dB, "stage_phase_deg": accept.phase_margin_deg}


DRAWS = 1
"""Injections for each loop: 5 s; what one tells less than two is told by the checks before."""


def closed_loops(axis: Axis, name: str) -> tuple[str, ...]:
    """The loops of an axis that can be measured; CheckFailed where there is none."""
    stage = ("stage",) if axis.mode == "stage" and axis.outer is not None else ()
    strain = ("strain",) if axis.mode != "voltage" and axis.inner.mode != "feedforward" else ()
    if not stage + strain:
        raise CheckFailed(
            f"axis {name}: no loop is closed (mode {axis.mode}, inner.mode {axis.inner.mode}): nothing to measure"
        )
    return stage + strain


def of_the_model(axis: Axis, period_s: float) -> PlantFigures:
    """The figures of the model in the configuration; NaN where it has none."""
    if axis.outer is None:
        return PlantFigures()
    A, B, C = (np.array(part) for part in (axis.outer.model.A, axis.outer.model.B, axis.outer.model.C))
    return commissioned(System(A, B, C, 0.0, period_s))


def checked(
    configuration: Configuration, path: FeedbackPath, axis: str, responses: Mapping[str, Measured], time: datetime
) -> Check:
    """The check that `responses`, by the names of their loops, make at `time`."""
    settings = configuration.axes[axis]
    tuned = of_the_model(settings, configuration.loop.period_ns * 1e-9)
    figures = asdict(plant_figures(responses.get("stage"), responses.get("strain"), tuned))
    figures |= dict.fromkeys(MARGINS, math.nan)
    deviations: dict[str, float] = {}
    if "stage" in responses:
        found = judge_running(configuration, path, axis, "stage", responses["stage"])
        margins = found.measured[found.nominal]
        figures |= dict(zip(MARGINS, (margins.gain_dB, margins.phase_deg), strict=True))
        deviations = dict(zip(MARGINS, found.loop.margin_deviations(), strict=True))
    return Check(time, axis, tuning_hash(settings), figures, deviations)
