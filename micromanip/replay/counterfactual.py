"""The closed loop of a recording under another tuning: path error with its confidence, and the limits it would meet.

What a run comes to: the limits that it meets, and the range of its error over the models that may be true.

Some laws decide: the observer of the tooth is given up or not (W-216), the PID falls back (W-215), the cell stops.
Near such a decision two models that differ by a hair leave two errors that have nothing to do with each other, and the
spread of those on one side says nothing of the other. So models are sorted by what happens with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS, FaultKind
from micromanip.rt.laws.reference import SIGNAL
from micromanip.rt.records import CELL_PARAMETERS, MAX_OUTPUTS
from micromanip.rt.states import FALLBACK, NO_FAULT, OUTRUN, TOOTH_LOST, TRACKING
from micromanip.rt.telemetry import ROW

from .fitting import Models
from .kernel import NO_SWAP, SWAP_BEFORE, replay_rows
from .window import Window, counted_rows

Bits = NDArray[np.int64]

_QUANTILE, _WIDER = 2.045, 2.0
"""Of Student's distribution with 29 degrees of freedom, for 95 %; and by how much the interval is wider, since the
drawn models share what no drawing changes, such as their order (docs/decisions/0031, where it was measured)."""
_LEAST = np.array([[0.005], [0.015], [0.02]])
"""Share of rms, p99 and peak to which nothing is known: what the plays and the fitted actuator leave out."""
_GAPS = 2.5
"""By how much less is known where cycles are missing among the rows that count."""
_OTHERWISE = 0.1
"""Share by which the range goes beyond the few models with which something else happens."""
_FEW = 5
_NEARLY = 1.0 - 1e-9
"""A step of so much of the slew limit is at the limit."""
DECIDED = (1 << TOOTH_LOST) | (1 << FALLBACK)
"""Conditions that change what acts for good."""


class LimitMet(NamedTuple):
    """A limit that was met: its name and value, for how many cycles, and when first from the recording's beginning."""

    axis: str
    limit: str
    value: str
    cycles: int
    first_s: float


class Undecided(NamedTuple):
    """What happens with some of the models only: with how many of how many; `expected`: by the models as they are."""

    axis: str
    what: str
    code: str
    models: int
    of: int
    expected: bool


@dataclass(frozen=True)
class Outcome:
    """One run: rms, p99 and peak (3, axes), NaN where none counts; the `conditions` of each axis (axes,), as bits, of
    all rows and of those that `counted`; whether the cell stopped.
    """

    um: Array
    conditions: Bits
    counted: Bits
    stopped: bool

    def happens(self) -> Bits:
        """What decides about the errors (axes,): two runs with the same are comparable."""
        return (self.conditions & DECIDED) | (1 if self.stopped else 0)


def ranges(nominal: Outcome, drawn: list[Outcome], others: list[Outcome], *, gaps: bool = False) -> tuple[Array, Array]:
    """Low and high end (3, axes) of the errors (um).

    By the spread of those `drawn` with which the same happens as with the models as they are; and as far as any go with
    which something else does, of the `others` as well, which are drawn more widely. The high end is infinite where the
    calm gains act for want of a set-point fast enough: the swings that they leave depend on every detail.
    """
    low, high = nominal.um.copy(), nominal.um.copy()
    every = [nominal, *drawn, *others]
    all_um = np.array([each.um for each in every])
    for i in range(nominal.um.shape[1]):
        mine, least = nominal.um[:, i], _LEAST[:, 0] * (_GAPS if gaps else 1.0)
        same = [each.um[:, i] for each in drawn if each.happens()[i] == nominal.happens()[i]]
        same = [um for um in same if np.isfinite(um).all()]
        half = np.zeros(3)
        if same:
            half = _WIDER * _QUANTILE * np.sqrt(np.mean((np.array(same) - mine) ** 2, axis=0))
        changes = bool(np.any(all_um[:, :, i] != mine))
        if changes:
            half = np.maximum(half, (least if len(same) >= _FEW else np.maximum(least, _OTHERWISE)) * mine)
        finite = all_um[np.isfinite(all_um[:, :, i]).all(axis=1), :, i]
        # a half that is longer than what it is from says how far up, not how far down
        smallest = finite.min(axis=0) if len(finite) else mine
        low[:, i] = np.where(half < mine, mine - half, 0.5 * smallest)
        high[:, i] = mine + half
        for each in every:
            um = each.um[:, i]
            if each.happens()[i] != nominal.happens()[i] and np.isfinite(um).all():
                low[:, i] = np.fmin(low[:, i], (1.0 - _OTHERWISE) * um)
                high[:, i] = np.fmax(high[:, i], (1.0 + _OTHERWISE) * um)
        if changes and any(each.counted[i] & (1 << OUTRUN) for each in every):
            high[:, i] = np.inf
    return low, high


def undecided(axes: list[str], every: list[Outcome]) -> list[Undecided]:
    """What happens in some of the runs but not in all; the first is of the models as they are."""
    found = []
    for i, axis in enumerate(axes):
        for number, kind in KINDS.items():
            with_it = [bool(each.conditions[i] & (1 << number)) for each in every]
            if any(with_it) and not all(with_it):
                found.append(Undecided(axis, _name(kind), kind.code, sum(with_it), len(every), with_it[0]))
    return found


def limits_met(window: Window, parameters: NDArray[Any], rows: NDArray[Any], begin: int) -> list[LimitMet]:
    """The limits of `parameters` (1,) that `rows` (n,), of the window from row `begin` on, meet; by the time."""
    found: list[LimitMet] = []
    per_ms = 1e6 / window.period_ns

    def add(axis: str, limit: str, value: str, met: NDArray[np.bool_]) -> None:
        if met.any():
            found.append(LimitMet(axis, limit, value, int(met.sum()), window.at_s(begin + int(np.argmax(met)))))

    def steps(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(np.diff(values, prepend=values[:1]))

    for i, axis in enumerate(window.axes):
        p, row = parameters[0]["axis"][i], rows["axis"][:, i]
        limiter, voltage, setpoint = p["limiter"], row["voltage_V"], row["setpoint_um"]
        low, high = float(limiter["low_V"]), float(limiter["high_V"])
        add(axis, "voltage", f"{low:g}..{high:g} V", (voltage <= low) | (voltage >= high))
        slew = float(limiter["slew_V"])
        add(axis, "voltage slew", f"{slew * per_ms:g} V/ms", steps(voltage) >= slew * _NEARLY)
        low, high = float(p["setpoint_low_um"]), float(p["setpoint_high_um"])
        add(axis, "stroke", f"{low:g}..{high:g} um", (setpoint <= low) | (setpoint >= high))
        slew = float(p["setpoint_slew_um"])
        add(axis, "set-point slew", f"{slew * per_ms:g} um/ms", steps(setpoint) >= slew * _NEARLY)
        for number, kind in KINDS.items():
            add(axis, _name(kind), kind.code, row["conditions"] & (1 << number) != 0)
    latched = rows["fault"][rows["fault"] != NO_FAULT]
    for number in np.unique(latched):
        kind = KINDS[int(number)]
        add("", _name(kind), kind.code, rows["fault"] == number)
    return sorted(found, key=lambda met: met.first_s)


def _name(kind: FaultKind) -> str:
    return kind.name.lower().replace("_", " ")


SETTLE_S = 0.3
"""After the other tuning has come in, or many cycles were missed, before its error counts."""
LEAST_S = 0.2
"""Of rows that count: with fewer nothing is said."""
DRAWS = 30
_WIDELY = 2.0
"""The spread of a third as many further models, by which decisions are looked for that the others do not meet."""
FIGURES = ("rms", "p99", "peak")


@dataclass(frozen=True)
class Expected:
    """Figures of the path error (um), by the models as they are, and the ends of its interval."""

    um: Array
    low_um: Array
    high_um: Array


@dataclass(frozen=True)
class Prediction:
    """What another tuning would have made of a window; `recorded` (3, axes) and `expected` are rms, p99 and peak.

    `stopped_s` is when the cell would have left TRACKING, from the beginning of the recording; `stops` the share of the
    models under which it does. `outrun` are the axes whose high ends are open.
    """

    recorded: Array
    recorded_limits: list[LimitMet]
    expected: Expected
    limits: list[LimitMet]
    stopped_s: float | None
    stops: float
    undecided: list[Undecided]
    outrun: list[str]


class Rerun:
    """Runs the cycles of a window with other parameters; room for the rows is made once."""

    def __init__(self, window: Window, models: Models) -> None:
        """Raises CheckFailed where nothing is left behind `SETTLE_S`."""
        self.window, self.models = window, models
        self.first = window.first + round(SETTLE_S * 1e9 / window.period_ns)
        if len(window.rows) <= self.first + 1:
            raise CheckFailed(
                f"{window.file}: only {window.seconds:.2f} s of it track, less than the {SETTLE_S:g} s that the other "
                "tuning is given to settle"
            )
        self.counts = counted_rows(window, self.first - window.first)
        least = min(LEAST_S * 1e9 / window.period_ns, len(window.rows) - self.first)
        if self.counts.sum() < least * (1.0 - 1e-9):
            raise CheckFailed(
                f"{window.file}: so many cycles are missing that of {window.seconds:.2f} s only "
                f"{self.counts.sum() * window.period_ns * 1e-9:.2f} s count, which lie {SETTLE_S:g} s behind the last "
                "gap: what another tuning does in a gap a recording does not tell; choose a quieter piece with --cut"
            )
        self._rows = np.zeros(len(window.rows), ROW)
        self._sets = np.zeros(2, CELL_PARAMETERS)
        self._scratch = np.zeros(1, ROW)

    def rows(self, parameters: NDArray[Any], models: NDArray[Any] | None = None) -> NDArray[Any]:
        """Rows (n,) with the set `parameters` (1,) from the first on, as far as they track; valid until the next call.

        Where the cell leaves TRACKING, that row is the last. The axes follow what they followed in the recording, a
        tracker's signal by the predictor of `parameters`.
        """
        window = self.window
        self._sets[0], self._sets[1] = window.parameters[0], parameters[0]
        for new, old in zip(self._sets[1]["axis"], window.parameters[0]["axis"], strict=True):
            if old["reference"]["kind"] != SIGNAL:
                new["reference"] = old["reference"]
        self._sets[1]["version"] = window.parameters[0]["version"]
        same = self._sets[0].tobytes() == self._sets[1].tobytes()
        count = replay_rows(
            self._sets,
            window.state.copy(),
            window.signals.copy(),
            np.zeros(MAX_OUTPUTS),
            window.samples,
            window.rows,
            window.commands,
            self._rows,
            NO_SWAP if same else SWAP_BEFORE,
            window.first,
            self.models.nominal if models is None else models,
            self.models.begin.copy(),
            self.models.free_um,
            self._scratch,
        )
        return self._rows[:count]

    @property
    def left_out_s(self) -> float:
        """How long it tracks, settled, in rows that don't count."""
        left_out = self.window.rows["periods"][self.first :][~self.counts[self.first :]]
        return float(left_out.sum()) * self.window.period_ns * 1e-9

    def figures(self, rows: NDArray[Any], until: int | None = None) -> Array:
        """rms, p99 and peak (3, axes) of the path error (um) in the rows that count, before row `until`, as long as
        `rows` track; NaN where there is none.
        """
        last = self.tracked(rows) if until is None else min(until, self.tracked(rows))
        counted = rows["axis"]["path_error_um"][:last][self.counts[:last]]
        if not len(counted):
            return np.full((3, len(self.window.axes)), np.nan)
        error = np.abs(counted[:, : len(self.window.axes)])
        rms = np.sqrt(np.mean(error**2, axis=0))
        place = int(0.99 * (len(error) - 1))
        return np.stack([rms, np.partition(error, place, axis=0)[place], error.max(axis=0)])

    def outcome(self, rows: NDArray[Any], until: int | None = None) -> Outcome:
        """What happens in `rows`, whose figures go to row `until`."""
        last = self.tracked(rows)
        conditions = rows["axis"]["conditions"][: last + 1, : len(self.window.axes)]
        seen = [
            np.asarray(np.bitwise_or.reduce(each, axis=0), dtype=np.int64)
            for each in (conditions[self.window.first :], conditions[self.counts[: len(conditions)]])
        ]
        return Outcome(self.figures(rows, until), seen[0], seen[1], last < len(rows))

    def tracked(self, rows: NDArray[Any]) -> int:
        """How many of `rows` pass before the cell leaves TRACKING, or a fault keeps it from getting there."""
        stopped = (rows["fault"] != NO_FAULT) & (self.window.rows["fault"][: len(rows)] == NO_FAULT)
        stopped[self.window.first :] |= rows["state"][self.window.first :] != TRACKING
        return int(np.argmax(stopped)) if stopped.any() else len(rows)


def predict(rerun: Rerun, parameters: NDArray[Any], draws: int = DRAWS) -> Prediction:
    """What `parameters` (1,) would have made of the window: by the models as they are, and by `draws` others."""
    window, first = rerun.window, rerun.window.first
    rows = rerun.rows(parameters)
    tracked = rerun.tracked(rows)
    limits = limits_met(window, parameters, rows[first : tracked + 1], first)
    stopped_s = None if tracked == len(rows) else window.at_s(tracked)
    nominal = rerun.outcome(rows)

    def drawn(seed: int, spread: float) -> Outcome:
        return rerun.outcome(rerun.rows(parameters, rerun.models.drawn(seed, spread)), tracked)

    found = [drawn(seed, 1.0) for seed in range(draws)]
    others = [drawn(draws + seed, _WIDELY) for seed in range(-(-draws // 3))]
    every = [nominal, *found, *others]
    low, high = ranges(nominal, found, others, gaps=bool((window.rows["periods"][rerun.counts] > 1).any()))
    met = limits_met(window, window.parameters, window.rows[first:], first)
    outrun = [axis for axis, um in zip(window.axes, high[0], strict=True) if np.isinf(um)]
    stops = sum(each.stopped for each in every) / len(every)
    return Prediction(
        rerun.figures(window.rows, tracked), met, Expected(nominal.um, low, high), limits, stopped_s, stops,
        undecided(window.axes, every), outrun,
    )  # fmt: skip
