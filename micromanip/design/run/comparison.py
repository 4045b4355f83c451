"""Two recorded runs, quantity by quantity: by how much they differ, and whether their length lets one say so.

Rms values, whole and by band, are compared by their ratio. What is no mean of the samples (a greatest error, a
percentile of lateness) is told: nothing can be said of a single greatest value.

How well a figure of a run is known, and whether that of another run differs: with correlated samples.

Samples of a control error follow one another: 10,000 a second are not 10,000 observations. A mean is taken of batches
that are long beside the memory of what is averaged (method of batch means: Law and Kelton, Simulation Modeling and
Analysis, section 9.5); its spread over the batches says how well it is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import yaml
from scipy.stats import t as student

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.settings.change import ABSENT, differing, leaves

from .statistics import TIMING_PERCENT, AxisSums, BANDS_Hz, RecordedRun
from .sums import Counts

FEWEST = 8
"""Batches below which nothing is said of a spread."""
_MOST = 64
_MEMORY = 0.2
"""Correlation of neighbouring batches up to which they count as independent."""
_LEAST_SAMPLES = 200
LOWER, HIGHER, SAME = "lower", "higher", "no difference shown"


@dataclass(frozen=True)
class Mean:
    """A mean, the standard error of it, and of how many independent batches."""

    value: float
    standard_error: float
    batches: int

    @property
    def root(self) -> float:
        """Of a mean square: the rms."""
        return float(np.sqrt(self.value))


def mean_square(squares: Array, samples: int) -> Mean:
    """Of the squares of so many samples in order, or of means of equal blocks of them. CheckFailed for too few."""
    if samples < _LEAST_SAMPLES:
        raise CheckFailed(f"{samples} cycles of tracking are too few to judge; at least {_LEAST_SAMPLES} are needed")
    return batch_mean(squares)


def batch_mean(values: Array) -> Mean:
    """Of `values` (n,) in order, of which there are `FEWEST` at least.

    Where even the longest batches are correlated, the standard error is widened as for a first-order process.
    """
    count = min(_MOST, len(values))
    means = values
    while count >= FEWEST:
        means = values[: len(values) // count * count].reshape(count, -1).mean(axis=1)
        if _neighbours(means) < max(_MEMORY, 1.0 / np.sqrt(count)):
            break
        count //= 2
    left = min(max(_neighbours(means), 0.0), 0.9)  # what they still have of each other
    spread = float(np.std(means, ddof=1)) * np.sqrt((1 + left) / (1 - left) / len(means))
    return Mean(float(np.mean(values)), spread, len(means))


def _neighbours(means: Array) -> float:
    """Correlation of each with the next."""
    deviation = means - means.mean()
    total = float(deviation @ deviation)
    return float(deviation[1:] @ deviation[:-1]) / total if total > 0 else 0.0


@dataclass(frozen=True)
class Difference:
    """`value` of the second run in terms of the first, in `low` to `high` with 95 % confidence."""

    value: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """What can be said: lower, higher, or that these runs show no difference."""
        if self.high < 1.0:
            return LOWER
        return HIGHER if self.low > 1.0 else SAME


def ratio(first: Mean, second: Mean) -> Difference:
    """Of the rms of two mean squares, by Welch's test on their logarithms."""
    if first.value == 0 or second.value == 0:
        same = first.value == second.value
        return Difference(1.0, 1.0, 1.0) if same else Difference(np.inf, 0.0, np.inf)
    parts = [((each.standard_error / each.value) ** 2, each.batches) for each in (first, second)]
    variance = sum(part for part, _ in parts)
    freedom = variance**2 / max(sum(part**2 / (batches - 1) for part, batches in parts), 1e-300)  # Welch-Satterthwaite
    half = 0.5 * float(student.ppf(0.975, max(freedom, 1.0)) * np.sqrt(variance))
    found = second.root / first.root
    return Difference(found, found * float(np.exp(-half)), found * float(np.exp(half)))


@dataclass(frozen=True)
class AxisFigures:
    """One axis while it tracks: path error (um), voltage left to the nearer end of its range (V), error by band (um).

    `peak_Hz` is where most of the error is, with `peak_um` rms in the lines beside it.
    """

    rms_um: float
    max_um: float
    headroom_V: float | None
    bands_um: tuple[float, ...]
    peak_Hz: float
    peak_um: float


class Squares(NamedTuple):
    """Mean square of the error of an axis (um^2), whole and in each of `BANDS_Hz`; None of a run of some seconds."""

    whole: Mean
    bands: tuple[Mean | None, ...]


@dataclass(frozen=True)
class RunFigures:
    """A run: `tracking_s` of `seconds`, skipped and lost cycles, timing (ns) at p50, p99.9 and the maximum.

    `unread` are the times (from, to; s from the first row) in which the file is damaged; None at an end of the file.
    """

    file: str
    seconds: float
    tracking_s: float
    skipped: int
    lost: int
    faults: tuple[str, ...]
    lateness_ns: tuple[int, ...]
    compute_ns: tuple[int, ...]
    unread: tuple[tuple[float | None, float | None], ...]
    axes: Mapping[str, AxisFigures]
    squares: Mapping[str, Squares]

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {name: value for name, value in asdict(self).items() if name != "squares"}


def run_figures(run: RecordedRun) -> RunFigures:
    """Figures of a whole recording. CheckFailed where it does not track."""
    file, cell = run.telemetry.file, run.cell
    if not cell.rows:
        raise CheckFailed(f"{file}: there is no cycle in it")
    axes, judged = {}, {}
    for name, sums in run.axis.items():
        try:
            square = mean_square(sums.squares.found, sums.samples)
        except CheckFailed as problem:
            raise CheckFailed(f"{file}: axis {name}: {problem}") from problem
        power = sums.spectra.power
        judged[name] = Squares(square, tuple(batch_mean(each) if len(each) >= FEWEST else None for each in power.T))
        axes[name] = _axis(sums, power.mean(axis=0))
    return RunFigures(
        file=str(file),
        seconds=run.at_s(cell.last),
        tracking_s=cell.tracking_cycles * run.period_s,
        skipped=cell.skipped,
        lost=cell.lost,
        faults=tuple(
            KINDS[number].code if number in KINDS else str(number) for number in sorted(cell.faults) if number
        ),
        lateness_ns=_timing(cell.timing["lateness"]),
        compute_ns=_timing(cell.timing["compute"]),
        unread=tuple(
            (None if each.first is None else run.at_s(each.first), None if each.last is None else run.at_s(each.last))
            for each in run.unread
        ),
        axes=axes,
        squares=judged,
    )


def _axis(sums: AxisSums, bands: Array) -> AxisFigures:
    frequency, density = sums.spectra.frequency_Hz, sums.spectra.density
    step = float(frequency[1])
    at = 1 + int(np.argmax(density[1:]))
    near = float(np.sqrt(density[max(1, at - 2) : at + 3].sum() * step))  # a line of the Hann window is five wide
    return AxisFigures(
        rms_um=float(np.sqrt(sums.sum_of_squares / sums.samples)),
        max_um=sums.greatest_um,
        headroom_V=sums.least_left_V if np.isfinite(sums.least_left_V) else None,
        bands_um=tuple(np.sqrt(bands).tolist()),
        peak_Hz=float(frequency[at]),
        peak_um=near,
    )


def _timing(counts: Counts) -> tuple[int, ...]:
    return tuple(int(value) for value in counts.percentiles((*TIMING_PERCENT, 100.0)))


def configuration_changes(first: str, second: str) -> list[dict[str, Any]]:
    """Keys whose values differ in two configurations' texts: ``key``, ``old``, ``new``; None for what is not there."""
    found = differing(*(leaves(yaml.safe_load(text) or {}) for text in (first, second)))
    known = {path: [None if value is ABSENT else value for value in pair] for path, pair in found.items()}
    return [{"key": ".".join(map(str, path)), "old": old, "new": new} for path, (old, new) in known.items()]


TOO_SHORT, NOT_JUDGED = "too short to judge", "not judged"

ERROR = "error rms"
"""The quantity that a page shows whether it differs or not."""


@dataclass(frozen=True)
class Compared:
    """A quantity of both runs, in `unit`; B minus A is between `low` and `high` with 95 % confidence.

    `axis` is "" for what the whole cell has. Where the run is too short, and of what is no mean, `low` and `high` are
    None.
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
    found: list[Compared] = []
    for axis in (name for name in runs[0].axes if name in runs[1].axes):
        a, b = (run.squares[axis] for run in figures)
        one, two = (run.axes[axis] for run in figures)
        found.append(_rms(axis, ERROR, a.whole, b.whole))
        for k, (low, high) in enumerate(BANDS_Hz):
            both = one.bands_um[k], two.bands_um[k]
            found.append(_rms(axis, f"{ERROR} {low:g}-{high:g} Hz", a.bands[k], b.bands[k], both))
        found.append(_told(axis, "error, greatest", "um", one.max_um, two.max_um))
        if one.headroom_V is not None and two.headroom_V is not None:
            found.append(_told(axis, "voltage left, least", "V", one.headroom_V, two.headroom_V))
    for name in runs[0].cell.timing:
        each = [[1e-3 * ns for ns in run.cell.timing[name].percentiles(TIMING_PERCENT)] for run in runs]
        found += [
            _told("", f"{name} p{percent:g}", "us", *us) for percent, *us in zip(TIMING_PERCENT, *each, strict=True)
        ]
    return found


def _told(axis: str, quantity: str, unit: str, a: float, b: float) -> Compared:
    return Compared(axis, quantity, unit, a, b, None, None, NOT_JUDGED)


def _rms(axis: str, quantity: str, a: Mean | None, b: Mean | None, both: Sequence[float] = ()) -> Compared:
    if a is None or b is None:
        return Compared(axis, quantity, "um", both[0], both[1], None, None, TOO_SHORT)
    found = ratio(a, b)
    low, high = (a.root * (bound - 1.0) for bound in (found.low, found.high))
    return Compared(axis, quantity, "um", a.root, b.root, low, high, found.verdict)
