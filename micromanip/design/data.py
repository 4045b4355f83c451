"""A recording for identification: one input and one output, judged before a fit; columns that stand still, refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Array, TimeSeries, Wanted, take
from micromanip.recordings.spikes import runs

_CLEARLY = 0.5
"""Correlation."""


def stands_still(values: Array) -> bool:
    """Whether `values` (n,) are one value, to rounding."""
    return bool(np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())))


def moves_against(values: Array, other: Array) -> bool:
    """Whether `values` (n,) fall while `other` (n,), which moves, rises."""
    return not stands_still(values) and float(np.corrcoef(values, other)[0, 1]) < -_CLEARLY


def require_movement(series: TimeSeries, columns: int | None = None) -> None:
    """Refuse columns, or the first of them, that stand still."""
    for name in series.names[:columns]:
        if stands_still(series[name]):
            raise CheckFailed(
                f"{series.file}: {name} is constant: record while the actuator moves over the stroke that it will use"
            )


def same_rate(records: Sequence[TimeSeries]) -> None:
    """CheckFailed unless all records are sampled alike."""
    first = records[0]
    for other in records[1:]:
        if abs(other.step_s / first.step_s - 1.0) > _SAME_RATE:
            raise CheckFailed(
                f"{other.file}: sampled every {other.step_s:.6g} s, {first.file} every {first.step_s:.6g} s; "
                "record all at one rate"
            )


_LEAST_SAMPLES, _SAME_RATE = 200, 0.01
_CLIPPED_RUN, _CLIPPED_CODES = 8, 4.0
_CLIPPED = ((0.0, 0.01, "at"), (0.002, 0.05, "near"))
"""Within this share of its stroke, none or that of the noise added behind what clips, the output rests while the input
goes on outwards by that share of its own, and by more than some steps of the sensor show at the top of a slow movement.
Behind a turn, where a hysteresis may rest, it is not looked at."""
_LONGEST_GAP = 0.1
"""Share of a record that may be missing at one place; beyond that the longest piece is used alone."""
_SHORT_GAP = 10
"""Samples that may be missing without a new burn-in: the input has hardly moved meanwhile."""


def counting(series: TimeSeries, burn_in_s: float) -> NDArray[np.bool_]:
    """Which samples (n,) are fitted to: measured, and `burn_in_s` behind the start and behind each longer gap.

    CheckFailed where too few would be left.
    """
    burn_in = round(burn_in_s / series.step_s)
    if len(series) - burn_in < _LEAST_SAMPLES:
        raise CheckFailed(
            f"{series.file}: {len(series)} samples less {burn_in} of burn-in are too few to fit to: record at least "
            f"{_LEAST_SAMPLES} more, several periods of the slowest movement"
        )
    doubtful = np.asarray(series.doubtful.any(axis=1))
    counts = ~doubtful
    for first in (0, *(last for first, last in runs(doubtful) if last - first >= _SHORT_GAP)):
        counts[first : first + burn_in] = False
    return counts


def load_record(file: Path, wanted: Wanted) -> TimeSeries:
    """Read and judge the two columns of `wanted`, input and output, of a recording of any kind: (n,) in V and um.

    Missing samples are filled in and don't count: they carry the model's memory across a gap. Raises CheckFailed, with
    what to record instead, for data that can't be used, UsageError for wrong names.
    """
    series = take(file, wanted)
    parts = series.parts(max(_LONGEST_GAP * len(series), _SHORT_GAP) - 1)
    if len(parts) > 1:
        series = series.rows(max(parts, key=lambda part: part.stop - part.start))
        told = f"the gap is too long to go on behind it: only the longest piece is used, {len(series)} samples"
        series = replace(series, notes=(*series.notes, told))
    series = series.filled()
    judge_record(series)
    return series


def judge_record(record: TimeSeries) -> None:
    """Raise for a record that no hysteresis model can be fitted to."""
    if len(record) < _LEAST_SAMPLES:
        raise CheckFailed(f"{record.file}: {len(record)} samples are too few; record at least {_LEAST_SAMPLES}")
    require_movement(record, 2)
    _judge_clipping(record)
    _judge_movement(record)


def _judge_clipping(record: TimeSeries) -> None:
    stroke = float(np.ptp(record.y))
    code = float(np.diff(np.unique(np.round(record.y / stroke, 9))).min())
    for end, limit, outwards in (("top", record.y.max(), 1.0), ("bottom", record.y.min(), -1.0)):
        for band, least, where in _CLIPPED:
            resting = np.abs(record.y - limit) <= band * stroke
            samples, travel = _furthest_rest(outwards * record.u, resting)
            if samples < _CLIPPED_RUN or travel <= max(least, _CLIPPED_CODES * code) * np.ptp(record.u):
                continue
            noise = ", but for noise," if band else ""
            raise CheckFailed(
                f"{record.file}: {record.names[1]} sticks {where} its {end} value {limit:.6g}{noise} for {samples} "
                "samples while the input goes on outwards: the sensor is clipped; shift its range, or record a smaller "
                "movement"
            )


def _furthest_rest(outwards: Array, resting: NDArray[np.bool_]) -> tuple[int, float]:
    """Of the runs of `resting` (n,): samples of that in which the input goes furthest outwards, and how far it goes.

    That with which a record begins is none: the output has not been seen to come there.
    """
    rests = [each for each in runs(resting) if each[0] > 0]
    found = ((last - first, float(outwards[first:last].max() - outwards[first])) for first, last in rests)
    return max(found, key=lambda rest: rest[1], default=(0, 0.0))


def _judge_movement(record: TimeSeries) -> None:
    """The output must follow the input, rising with it, and lag behind it."""
    u, y = record.u, record.y
    if moves_against(y, u):
        raise CheckFailed(
            f"{record.file}: {record.names[1]} falls when {record.names[0]} rises: turn the sensor's sign, "
            "or name the right columns"
        )
    correlation = float(np.corrcoef(u, y)[0, 1])
    if correlation < 0.5:
        raise CheckFailed(
            f"{record.file}: {record.names[1]} hardly follows {record.names[0]} (correlation {correlation:.2f}): "
            "are these the columns of one axis, recorded together?"
        )
    middle = 0.5 * (u.max() + u.min())
    crossings = np.count_nonzero(np.diff(np.sign(u - middle)) != 0)
    if crossings < 4:
        raise CheckFailed(
            f"{record.file}: {record.names[0]} passes its middle only {crossings} times: "
            "record at least two full periods"
        )
    # a lagging output encloses area clockwise in the (y, u) plane; swapped columns turn it around
    area = float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(u)) - 0.5 * (y[-1] + y[0]) * (u[-1] - u[0]))
    if area > 1e-3 * crossings / 2 * np.ptp(u) * np.ptp(y):
        raise CheckFailed(
            f"{record.file}: {record.names[1]} runs ahead of {record.names[0]}: the columns are probably mixed up "
            f"(--input is the voltage, --output the displacement)"
        )
