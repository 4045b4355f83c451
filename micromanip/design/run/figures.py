"""Figures of a recorded run, and the keys in which two configurations differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import yaml

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS

from .confidence import FEWEST, Array, Mean, batch_mean, mean_square
from .statistics import TIMING_PERCENT, AxisSums, RecordedRun
from .sums import Counts


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
            square = mean_square(sums.squares.means, sums.samples)
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
