"""The closed loop of a recording under another tuning: path error with its confidence, and the limits it would meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.laws.reference import SIGNAL
from micromanip.rt.records import CELL_PARAMETERS, MAX_OUTPUTS
from micromanip.rt.states import NO_FAULT, TRACKING
from micromanip.rt.telemetry import ROW

from .fitting import Models
from .kernel import NO_SWAP, SWAP_BEFORE, replay_rows
from .outcomes import LimitMet, Outcome, Undecided, limits_met, ranges, undecided
from .window import Window, counted_rows

SETTLE_S = 0.3
"""After the other tuning has come in, or many cycles were missed, before its error counts."""
LEAST_S = 0.2
"""Of rows that count: with fewer nothing is said."""
DRAWS = 30
_WIDELY = 2.0
"""The spread of a third as many further models, by which decisions are looked for that the others do not meet."""
FIGURES = ("rms", "p99", "peak")

Array = NDArray[np.float64]


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

    def __init__(self, window: Window, models: Models, settle_s: float = SETTLE_S) -> None:
        """Raises CheckFailed where nothing is left behind `settle_s`."""
        self.window, self.models = window, models
        self.first = window.first + round(settle_s * 1e9 / window.period_ns)
        if len(window.rows) <= self.first + 1:
            raise CheckFailed(
                f"{window.file}: only {window.seconds:.2f} s of it track, less than the {settle_s:g} s that the other "
                "tuning is given to settle"
            )
        self.counts = counted_rows(window, self.first - window.first)
        least = min(LEAST_S * 1e9 / window.period_ns, len(window.rows) - self.first)
        if self.counts.sum() < least * (1.0 - 1e-9):
            raise CheckFailed(
                f"{window.file}: so many cycles are missing that of {window.seconds:.2f} s only "
                f"{self.counts.sum() * window.period_ns * 1e-9:.2f} s count, which lie {settle_s:g} s behind the last "
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
