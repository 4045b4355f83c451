"""Two recorded runs, quantity by quantity: by how much they differ, and whether their length lets one say so.

Rms values, whole and by band, are compared by their ratio. What is no mean of the samples (a greatest error, a
percentile of lateness) is taken of sections of one length in both runs, and the mean over the sections is compared:
nothing can be said of a single greatest value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .confidence import FEWEST, Array, Mean, batch_mean, change, ratio
from .figures import RunFigures
from .statistics import SECTIONS_S, TIMING_PERCENT, BANDS_Hz, RecordedRun
from .sums import Sections

TOO_SHORT = "too short to judge"

ERROR = "error rms"
"""The quantity that a page shows whether it differs or not."""


@dataclass(frozen=True)
class Compared:
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


def compared(runs: Sequence[RecordedRun], figures: Sequence[RunFigures]) -> list[Compared]:
    """Two runs and their figures, compared: each axis that both have, then the timing."""
    shortest_s = min(run.cell.tracked * run.period_s for run in runs)
    section_s = next((each for each in SECTIONS_S if FEWEST * each <= shortest_s * (1.0 + 1e-9)), None)
    found: list[Compared] = []
    for axis in (name for name in runs[0].axes if name in runs[1].axes):
        a, b = (run.squares[axis] for run in figures)
        found.append(_rms(axis, ERROR, a.whole, b.whole))
        for k, (low, high) in enumerate(BANDS_Hz):
            both = [run.axes[axis].bands_um[k] for run in figures]
            found.append(_rms(axis, f"{ERROR} {low:g}-{high:g} Hz", a.bands[k], b.bands[k], both))
        series = [_found(run.axis[axis].sections, section_s, "error") for run in runs]
        whole = [run.axes[axis].max_um for run in figures]
        found.append(by_section(axis, "error, greatest of a section", "um", series, whole))
        least = [run.axes[axis].headroom_V for run in figures]
        if all(each is not None for each in least):
            series = [_found(run.axis[axis].sections, section_s, "left") for run in runs]
            found.append(
                by_section(axis, "voltage left, least of a section", "V", series, [each or 0.0 for each in least])
            )
    for name in runs[0].cell.timing:
        series = [_found(run.timing_sections, section_s, name) for run in runs]
        for k, percent in enumerate(TIMING_PERCENT):
            whole = [1e-3 * run.cell.timing[name].percentiles((percent,))[0] for run in runs]
            columns = [each[:, k] if len(each) else each for each in series]
            found.append(by_section("", f"{name} p{percent:g}", "us", columns, whole))
    return found


def _found(sections: Mapping[float, Mapping[str, Sections]], section_s: float | None, name: str) -> Array:
    """Values by section; none where no length is short enough, or none of its cycles at this rate."""
    return sections[section_s][name].found if section_s is not None and section_s in sections else np.empty(0)


def _rms(axis: str, quantity: str, a: Mean | None, b: Mean | None, both: Sequence[float] = ()) -> Compared:
    if a is None or b is None:
        return Compared(axis, quantity, "um", both[0], both[1], None, None, TOO_SHORT)
    found = ratio(a, b)
    low, high = (a.root * (bound - 1.0) for bound in (found.low, found.high))
    return Compared(axis, quantity, "um", a.root, b.root, low, high, found.verdict)


def by_section(axis: str, quantity: str, unit: str, series: Sequence[Array], whole: Sequence[float]) -> Compared:
    """What was taken of each section of both runs (sections,), its means compared; `whole` are of each run as one."""
    if min(map(len, series)) < FEWEST:
        return Compared(axis, quantity, unit, whole[0], whole[1], None, None, TOO_SHORT)
    one, two = map(batch_mean, series)
    found = change(one, two)
    return Compared(axis, quantity, unit, one.value, two.value, found.low, found.high, found.verdict)
