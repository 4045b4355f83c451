"""Figures of a recorded run, and the keys in which two configurations differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.signal import spectrogram

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS

from .run_columns import RecordedRun
from .run_confidence import FEWEST, Array, Mean, batch_mean, mean_square

BANDS_Hz = ((0.0, 10.0), (10.0, 100.0), (100.0, 1000.0), (1000.0, 5000.0))
_SPECTRUM_S = 1.0


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
    squares: Mapping[str, Squares]

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {name: value for name, value in asdict(self).items() if name != "squares"}


def run_figures(run: RecordedRun) -> RunFigures:
    """Figures of a whole recording. CheckFailed where it does not track, or is damaged."""
    file, cycle, periods = run.telemetry.file, run.column("cycle"), run.column("periods")
    if not len(cycle):
        raise CheckFailed(f"{file}: there is no cycle in it")
    axes, judged = {}, {}
    for name in run.axes:
        error = run.error_um(name)
        try:
            square = mean_square(error)
        except CheckFailed as problem:
            raise CheckFailed(f"{file}: axis {name}: {problem}") from problem
        frequency, density = spectra(error, 1.0 / run.period_s)
        judged[name] = Squares(square, _by_band(frequency, density))
        axes[name] = _axis(run, name, error, frequency, density.mean(axis=1))
    faults = np.unique(run.column("fault"))
    return RunFigures(
        file=str(file),
        seconds=float((cycle[-1] - cycle[0]) * run.period_s),
        tracking_s=float(periods[run.tracks].sum() * run.period_s),
        skipped=int((periods - 1).clip(0).sum()),
        lost=int((np.diff(cycle) - periods[1:]).clip(0).sum()),
        faults=tuple(KINDS[int(number)].code if int(number) in KINDS else str(number) for number in faults if number),
        lateness_ns=_percentiles(run.column("lateness_ns")),
        compute_ns=_percentiles(run.column("compute_ns")),
        axes=axes,
        squares=judged,
    )


def spectra(error: Array, rate_Hz: float) -> tuple[Array, Array]:
    """Frequency (f,) and power density (f, s) of segments of 1 s that overlap by a half: their mean is Welch's."""
    segment = min(len(error), round(_SPECTRUM_S * rate_Hz))
    frequency, _, density = spectrogram(error, rate_Hz, "hann", segment, segment // 2, detrend="constant")
    return frequency, density


def _by_band(frequency: Array, density: Array) -> tuple[Mean | None, ...]:
    if density.shape[1] < FEWEST:
        return (None,) * len(BANDS_Hz)
    step = float(frequency[1])
    return tuple(batch_mean(_inside(frequency, density, band).sum(axis=0) * step) for band in BANDS_Hz)


def _inside(frequency: Array, density: Array, band: tuple[float, float]) -> Array:
    return density[(frequency >= band[0]) & (frequency < band[1])]


def _axis(run: RecordedRun, name: str, error: Array, frequency: Array, density: Array) -> AxisFigures:
    step = float(frequency[1])
    at = 1 + int(np.argmax(density[1:]))
    near = float(np.sqrt(density[max(1, at - 2) : at + 3].sum() * step))  # a line of the Hann window is five wide
    left = run.voltage_left(name)
    left = left[run.tracks] if len(left) else left
    return AxisFigures(
        rms_um=float(np.sqrt(np.mean(error**2))),
        max_um=float(np.abs(error).max()),
        headroom_V=float(left.min()) if len(left) else None,
        bands_um=tuple(float(np.sqrt(_inside(frequency, density, band).sum() * step)) for band in BANDS_Hz),
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
