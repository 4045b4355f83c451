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
from .limits import Met, limits_met
from .window import Window

SETTLE_S = 0.3
"""After the other tuning has come in, before its error counts."""
DRAWS = 30
_QUANTILE, _WIDER = 2.045, 2.0
"""Of Student's distribution with 29 degrees of freedom, for 95 %; and by how much the interval is wider, since the
drawn models share what no drawing changes, such as their order (docs/decisions/0031, where it was measured)."""
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
    drawn models under which it does.
    """

    recorded: Array
    recorded_limits: list[Met]
    expected: Expected
    limits: list[Met]
    stopped_s: float | None
    stops: float


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

    def figures(self, rows: NDArray[Any]) -> Array:
        """rms, p99 and peak (3, axes) of the path error (um) behind the settling, as long as `rows` track."""
        tracked = rows[self.first : self.tracked(rows)]
        if not len(tracked):
            return np.full((3, len(self.window.axes)), np.nan)
        error = np.abs(tracked["axis"]["path_error_um"][:, : len(self.window.axes)])
        rms = np.sqrt(np.mean(error**2, axis=0))
        place = int(0.99 * (len(error) - 1))
        return np.stack([rms, np.partition(error, place, axis=0)[place], error.max(axis=0)])

    def tracked(self, rows: NDArray[Any]) -> int:
        """How many of `rows` pass before the cell leaves TRACKING, or a fault keeps it from getting there."""
        stopped = (rows["fault"] != NO_FAULT) & (self.window.rows["fault"][: len(rows)] == NO_FAULT)
        stopped[self.window.first :] |= rows["state"][self.window.first :] != TRACKING
        return int(np.argmax(stopped)) if stopped.any() else len(rows)


def predict(rerun: Rerun, parameters: NDArray[Any], draws: int = DRAWS) -> Prediction:
    """What `parameters` (1,) would have made of the window: by the models as they are, and by `draws` others."""
    window = rerun.window
    recorded = rerun.figures(window.rows)
    rows = rerun.rows(parameters)
    nominal, tracked = rerun.figures(rows), rerun.tracked(rows)
    first = window.first
    limits = limits_met(window, parameters, rows[first : tracked + 1], first)
    stopped_s = None if tracked == len(rows) else window.at_s(tracked)
    found, stops = [], 0
    for seed in range(draws):
        rows = rerun.rows(parameters, rerun.models.drawn(seed))
        stops += rerun.tracked(rows) < len(rows)
        found.append(rerun.figures(rows))
    half = _WIDER * _QUANTILE * np.sqrt(np.mean((np.array(found) - nominal) ** 2, axis=0))
    expected = Expected(nominal, np.maximum(nominal - half, 0.0), nominal + half)
    met = limits_met(window, window.parameters, window.rows[first:], first)
    return Prediction(recorded, met, expected, limits, stopped_s, stops / draws)
