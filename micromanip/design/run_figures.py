"""Figures of a recorded run, and how two runs differ: with the confidence that their length allows.

Samples of a control error follow one another: 10,000 a second are not 10,000 observations. The mean square is taken of
batches that are long beside the error's memory (method of batch means: Law and Kelton, Simulation Modeling and
Analysis, section 9.5); its spread over the batches says how well it is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.signal import welch
from scipy.stats import t as student

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.recordings import Telemetry
from micromanip.rt.states import TRACKING

Array = NDArray[np.float64]

BANDS_Hz = ((0.0, 10.0), (10.0, 100.0), (100.0, 1000.0), (1000.0, 5000.0))
_FEWEST, _MOST = 8, 64
_MEMORY = 0.2
"""Correlation of neighbouring batches up to which they count as independent."""
_LEAST_SAMPLES = 200
_SPECTRUM_S = 1.0


@dataclass(frozen=True)
class MeanSquare:
    """A mean square, the standard error of it, and of how many independent batches."""

    value: float
    standard_error: float
    batches: int

    @property
    def rms(self) -> float:
        """Its root."""
        return float(np.sqrt(self.value))


def mean_square(x: Array) -> MeanSquare:
    """Of the samples `x` (n,) in order. CheckFailed where there are too few, or even long batches are correlated."""
    if len(x) < _LEAST_SAMPLES:
        raise CheckFailed(f"{len(x)} cycles of tracking are too few to judge; at least {_LEAST_SAMPLES} are needed")
    squares = x * x
    count = _MOST
    means = squares
    while count >= _FEWEST:
        means = squares[: len(x) // count * count].reshape(count, -1).mean(axis=1)
        if _neighbours(means) < max(_MEMORY, 1.0 / np.sqrt(count)):
            break
        count //= 2
    left = min(max(_neighbours(means), 0.0), 0.9)  # what they still have of each other, as a first-order process
    spread = float(np.std(means, ddof=1)) * np.sqrt((1 + left) / (1 - left) / len(means))
    return MeanSquare(float(np.mean(squares)), spread, len(means))


def _neighbours(means: Array) -> float:
    """Correlation of each with the next."""
    deviation = means - means.mean()
    total = float(deviation @ deviation)
    return float(deviation[1:] @ deviation[:-1]) / total if total > 0 else 0.0


@dataclass(frozen=True)
class Difference:
    """`ratio` of the rms of the second run to that of the first, and the interval it is in with 95 % confidence."""

    ratio: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """What can be said: lower, higher, or that these runs show no difference."""
        if self.high < 1.0:
            return "lower"
        return "higher" if self.low > 1.0 else "no difference shown"


def difference(first: MeanSquare, second: MeanSquare) -> Difference:
    """By Welch's test on the logarithms of the mean squares."""
    if first.value == 0 or second.value == 0:
        same = first.value == second.value
        return Difference(1.0, 1.0, 1.0) if same else Difference(np.inf, 0.0, np.inf)
    parts = [(each.standard_error / each.value) ** 2 for each in (first, second)]
    variance = sum(parts)
    freedom = variance**2 / max(
        sum(part**2 / (each.batches - 1) for part, each in zip(parts, (first, second), strict=True)), 1e-300
    )
    half = 0.5 * float(student.ppf(0.975, max(freedom, 1.0))) * np.sqrt(variance)
    ratio = second.rms / first.rms
    return Difference(ratio, ratio * float(np.exp(-half)), ratio * float(np.exp(half)))


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


@dataclass(frozen=True)
class RunFigures:
    """A run: `tracking_s` of `seconds`, skipped and lost cycles, timing (ns) at p50, p99.9 and the maximum."""

    file: str
    seconds: float
    tracking_s: float
    skipped: int
    lost: int
    faults: tuple[str, ...]
    lateness_ns: tuple[int, ...]
    compute_ns: tuple[int, ...]
    axes: Mapping[str, AxisFigures]
    squares: Mapping[str, MeanSquare]

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {name: value for name, value in asdict(self).items() if name != "squares"}


def run_figures(telemetry: Telemetry) -> RunFigures:
    """Figures of a whole recording. CheckFailed where it does not track, or is damaged."""
    cycle, periods = telemetry.column("cycle"), telemetry.column("periods")
    if not len(cycle):
        raise CheckFailed(f"{telemetry.file}: there is no cycle in it")
    tracks = telemetry.column("state") == TRACKING
    period_s = telemetry.period_ns * 1e-9
    axes, squares = {}, {}
    for place, name in enumerate(telemetry.axes):
        error = telemetry.column(f"axis.{place}.path_error_um")
        kept = error[tracks & np.isfinite(error)]
        try:
            squares[name] = mean_square(kept)
        except CheckFailed as problem:
            raise CheckFailed(f"{telemetry.file}: axis {name}: {problem}") from problem
        axes[name] = _axis(telemetry, place, kept, telemetry.column(f"axis.{place}.voltage_V")[tracks])
    faults = np.unique(telemetry.column("fault"))
    return RunFigures(
        file=str(telemetry.file),
        seconds=float((cycle[-1] - cycle[0]) * period_s),
        tracking_s=float(periods[tracks].sum() * period_s),
        skipped=int((periods - 1).clip(0).sum()),
        lost=int((np.diff(cycle) - periods[1:]).clip(0).sum()),
        faults=tuple(KINDS[int(number)].code if int(number) in KINDS else str(number) for number in faults if number),
        lateness_ns=_percentiles(telemetry.column("lateness_ns")),
        compute_ns=_percentiles(telemetry.column("compute_ns")),
        axes=axes,
        squares=squares,
    )


def _axis(telemetry: Telemetry, place: int, error: Array, voltage: Array) -> AxisFigures:
    rate_Hz = 1e9 / telemetry.period_ns
    frequency, density = welch(error, rate_Hz, nperseg=min(len(error), round(_SPECTRUM_S * rate_Hz)))
    step = float(frequency[1])
    bands = tuple(
        float(np.sqrt(density[(frequency >= low) & (frequency < high)].sum() * step)) for low, high in BANDS_Hz
    )
    at = 1 + int(np.argmax(density[1:]))
    near = float(np.sqrt(density[max(1, at - 2) : at + 3].sum() * step))  # a line of the Hann window is five wide
    headroom = None
    if telemetry.parameters and len(voltage):
        limits = [each["axis"][0, place]["limiter"] for each in telemetry.parameters]
        low, high = max(float(one["low_V"]) for one in limits), min(float(one["high_V"]) for one in limits)
        headroom = float(min(voltage.min() - low, high - voltage.max()))
    return AxisFigures(
        rms_um=float(np.sqrt(np.mean(error**2))),
        max_um=float(np.abs(error).max()),
        headroom_V=headroom,
        bands_um=bands,
        peak_Hz=float(frequency[at]),
        peak_um=near,
    )


def _percentiles(values: NDArray[Any]) -> tuple[int, ...]:
    return tuple(int(value) for value in (*np.percentile(values, (50.0, 99.9)), values.max()))


def configuration_changes(first: str, second: str) -> list[dict[str, Any]]:
    """Keys whose values differ in two configurations' texts: ``key``, ``old``, ``new``; None for what is not there."""
    old, new = _flat("", yaml.safe_load(first)), _flat("", yaml.safe_load(second))
    keys = [*old, *(key for key in new if key not in old)]
    return [{"key": k, "old": old.get(k), "new": new.get(k)} for k in keys if old.get(k) != new.get(k)]


def _flat(key: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        return {key: value}
    found: dict[str, Any] = {}
    for name, entry in value.items():
        found |= _flat(f"{key}.{name}" if key else str(name), entry)
    return found
