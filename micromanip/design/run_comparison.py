"""Two recorded runs, quantity by quantity: by how much they differ, and whether their length lets one say so.

Rms values, whole and by band, are compared by their ratio. What is no mean of the samples (a greatest error, a
percentile of lateness) is taken of sections of one length in both runs, and the mean over the sections is compared:
nothing can be said of a single greatest value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .run_columns import RecordedRun
from .run_confidence import FEWEST, Array, Mean, batch_mean, change, difference
from .run_figures import BANDS_Hz, RunFigures

TOO_SHORT = "too short to judge"
_SECTION_S = 1.0
_LEAST_CYCLES = 1000
"""In a section: a p99.9 of fewer is its maximum."""
_TIMING = (("lateness", 50.0), ("lateness", 99.9), ("compute", 50.0), ("compute", 99.9))


@dataclass(frozen=True)
class Judged:
    """A quantity of both runs, in `unit`; B minus A is between `low` and `high` with 95 % confidence.

    `axis` is "" for what the whole cell has; without a verdict the run is too short, and `low` and `high` are None.
    """

    axis: str
    quantity: str
    unit: str
    a: float
    b: float
    low: float | None
    high: float | None
    verdict: str

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)


def judged(runs: Sequence[RecordedRun], figures: Sequence[RunFigures]) -> list[Judged]:
    """Two runs and their figures, compared: each axis that both have, then the timing."""
    shortest_s = min(np.count_nonzero(run.tracks) * run.period_s for run in runs)
    sections = [round(min(_SECTION_S, shortest_s / FEWEST) / run.period_s) for run in runs]
    found: list[Judged] = []
    for axis in (name for name in runs[0].axes if name in runs[1].axes):
        a, b = (run.squares[axis] for run in figures)
        found.append(_rms(axis, "error rms", a.whole, b.whole))
        for k, (low, high) in enumerate(BANDS_Hz):
            both = [run.axes[axis].bands_um[k] for run in figures]
            found.append(_rms(axis, f"error rms {low:g}-{high:g} Hz", a.bands[k], b.bands[k], both))
        errors = [np.abs(run.error_um(axis)) for run in runs]
        found.append(_sections(axis, "error, greatest of a section", "um", errors, sections, np.max))
        if all(run.voltage_range(axis) for run in runs):
            left = [run.voltage_left(axis)[run.tracks] for run in runs]
            found.append(_sections(axis, "voltage left, least of a section", "V", left, sections, np.min))
    for name, percent in _TIMING:
        values = [run.column(f"{name}_ns") * 1e-3 for run in runs]
        found.append(_sections("", f"{name} p{percent:g}", "us", values, sections, _percentile(percent)))
    return found


def _percentile(percent: float) -> Callable[[Array], float]:
    return lambda values: float(np.percentile(values, percent))


def _rms(axis: str, quantity: str, a: Mean | None, b: Mean | None, both: Sequence[float] = ()) -> Judged:
    if a is None or b is None:
        return Judged(axis, quantity, "um", both[0], both[1], None, None, TOO_SHORT)
    found = difference(a, b)
    low, high = (a.root * (bound - 1.0) for bound in (found.low, found.high))
    return Judged(axis, quantity, "um", a.root, b.root, low, high, found.verdict)


def _sections(
    axis: str,
    quantity: str,
    unit: str,
    values: Sequence[Array],
    lengths: Sequence[int],
    of_section: Callable[[Array], float],
) -> Judged:
    """`of_section` of each section of so many samples, its mean over the sections compared."""
    series = [
        np.array([of_section(part) for part in each[: len(each) // length * length].reshape(-1, length)])
        if length >= _LEAST_CYCLES
        else np.empty(0)
        for each, length in zip(values, lengths, strict=True)
    ]
    if min(map(len, series)) < FEWEST:
        a, b = (float(of_section(each)) for each in values)
        return Judged(axis, quantity, unit, a, b, None, None, TOO_SHORT)
    one, two = map(batch_mean, series)
    found = change(one, two)
    return Judged(axis, quantity, unit, one.value, two.value, found.low, found.high, found.verdict)
