"""Experiments for a linear fit: columns of recordings, judged before anything is fitted to them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import decimate

from micromanip.control.system import Array
from micromanip.design.data import require_movement, stands_still
from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries, Wanted, take
from micromanip.recordings.loader import LISTS
from micromanip.recordings.time_series import joined

# Unlike a hysteresis, a plant with dynamics may turn anywhere, whatever its input does. So it is looked at how an
# output comes to its extreme: within bands of it that grow fourfold the samples of a smooth peak double, those of a
# limit stay.

_BAND, _WIDER = 0.002, 4.0
"""Of the output's stroke; and how many times that the wider band is."""
_CODE, _CODES = 0.5, 3.5
"""The least of both in steps of a coarse converter."""
_PILED, _FEWEST, _SHARE = 0.7, 8, 0.005
_MOVING = 0.02
"""Mean way of an input, as a share of its stroke, meanwhile: where it rests, as after a step, its output may."""


def clipped(u: Array, y: Array) -> str | None:
    """Which end of its range an output `y` (n,) sticks at while one of the inputs `u` (n, m) moves; None: at none."""
    stroke = float(np.ptp(y))
    steps = np.diff(np.unique(np.round((y - y.min()) / stroke, 9)))
    step = stroke * float(steps.min())
    for end, limit in (("top", y.max()), ("bottom", y.min())):
        away = np.abs(y - limit)
        near = away <= max(_BAND * stroke, _CODE * step)
        wide = away <= max(_WIDER * _BAND * stroke, _CODES * step)
        if near.sum() < max(_FEWEST, _SHARE * len(y)) or near.sum() < _PILED * wide.sum():
            continue
        ways = np.median(np.abs(u[near] - np.median(u[near], axis=0)), axis=0)
        if np.any(ways > _MOVING * np.ptp(u, axis=0)):
            return f"sticks at its {end} value {limit:.6g} for {100.0 * near.mean():.2g} % of the samples"
    return None


_LEAST_SAMPLES, _LEAST_PIECE, _FILLED = 200, 100, 3
_WHOLE = 0.01
_COPY = 1e-9


def split_at(record: TimeSeries, share: float) -> list[TimeSeries]:
    """The first `share` of a record, and the rest, if any. CheckFailed where one of them is too short or stands still.

    Pieces that the cut leaves too short are left out.
    """
    count = round(share * len(record))
    parts = [_long(record.rows(part)) for part in (slice(0, count), slice(count, None)) if part.start < len(record)]
    for part, which in zip(parts, ("first", "last"), strict=False):
        if len(part) < _LEAST_SAMPLES // 2:
            raise CheckFailed(
                f"{record.file}: split at {share:g}, a part of {len(part)} samples is left, which is too short; "
                f"at least {_LEAST_SAMPLES // 2} are needed"
            )
        still = [name for name in part.names if stands_still(part[name])]
        if still:
            raise CheckFailed(
                f"{record.file}: split at {share:g}, {still[0]} stands still in the {which} {len(part)} samples: "
                "split elsewhere, or give --split 1 and with --validate a record that moves, if need be this one"
            )
    return parts


def _long(series: TimeSeries) -> TimeSeries:
    """Its parts without a gap that are long enough to be used; all of it where none is."""
    kept = [np.arange(len(series))[part] for part in series.parts() if part.stop - part.start >= _LEAST_PIECE]
    return series.rows(np.concatenate(kept)) if kept else series


def load_linear(file: Path, wanted: Wanted, inputs: int = LISTS) -> TimeSeries:
    """Read the columns of `wanted`: the first `inputs` of them are, the others outputs; or a list of each.

    Its `step_s` is the sampling interval, s, of the model: that of the record's time column, or a whole multiple of it,
    for which the record is low-passed and thinned. Parts without a gap are experiments of their own. Raises
    CheckFailed, with what to record instead, for data that can't be used.
    """
    series = take(file, replace(wanted, inputs=inputs))
    if len(series) < _LEAST_SAMPLES:
        raise CheckFailed(f"{file}: {len(series)} samples are too few; record at least {_LEAST_SAMPLES}")
    require_movement(series)
    _require_different(series)
    step_s = series.step_s if wanted.step_s is None or wanted.rate_hz is not None else wanted.step_s
    thin = _thinning(file, series.step_s, step_s)
    used, notes = _whole_parts(series.bridged())
    notes += _clipping(used)
    return replace(_thinned(used, thin), step_s=step_s, notes=(*series.notes, *notes))


def _thinned(series: TimeSeries, thin: int) -> TimeSeries:
    """Each part low-passed, and one sample of `thin`: all columns by the same filter, which so cancels in a model."""
    if thin == 1:
        return series
    parts = []
    for k, part in enumerate(map(series.rows, series.parts())):
        values = np.asarray(decimate(part.values, thin, ftype="fir", axis=0))
        index = part.index[0] // thin + 2 * k + np.arange(len(values))  # a gap stays one, however short
        parts.append(replace(part, values=values, index=index, doubtful=part.doubtful[::thin]))
    return joined(parts)


def _whole_parts(series: TimeSeries) -> tuple[TimeSeries, list[str]]:
    """The parts without a gap that are long enough to be used, and what is to be told."""
    parts, notes = [series.rows(part) for part in series.parts()], []
    if sum(len(part) for part in parts if len(part) >= _LEAST_PIECE) < 0.5 * len(series):
        parts = [series.rows(part).filled() for part in series.parts(_FILLED)]
        notes.append(
            f"of the missing samples {sum(map(len, parts)) - len(series)}, in gaps of at most {_FILLED}, are filled in "
            "along straight lines, as the parts between are too short to be fitted to: fast dynamics are blurred"
        )
    long = [part for part in parts if len(part) >= _LEAST_PIECE]
    if sum(map(len, long)) < _LEAST_SAMPLES:
        raise CheckFailed(
            f"{series.file}: of {len(parts)} parts between gaps the longest has {max(map(len, parts))} samples, which "
            f"is too short; record without gaps, at least {_LEAST_SAMPLES} samples"
        )
    if short := len(parts) - len(long):
        notes.append(
            f"{short} of {len(parts)} parts between gaps are shorter than {_LEAST_PIECE} samples and are left out"
        )
    return joined(long), notes


def _clipping(series: TimeSeries) -> list[str]:
    """What is to be told of outputs that look clipped."""
    return [
        f"{name} {how} while the input moves: where the sensor is clipped, poles and gains are not the plant's; "
        "shift its range, or record a smaller movement"
        for name in series.names[series.inputs :]
        if (how := clipped(series.values[:, : series.inputs], series[name])) is not None
    ]


def _thinning(file: Path, step: float, dt: float) -> int:
    ratio = dt / step
    if abs(ratio - round(ratio)) > _WHOLE * ratio or round(ratio) < 1:
        raise CheckFailed(
            f"{file}: --dt {dt:.6g} s is no whole multiple of the record's sampling interval, {step:.6g} s"
        )
    return round(ratio)


def _require_different(series: TimeSeries) -> None:
    """Inputs that are copies of one another can't be told apart."""
    names, table = series.names[: series.inputs], series.values[:, : series.inputs]
    table = (table - table.mean(axis=0)) / table.std(axis=0)
    values, vectors = np.linalg.eigh(table.T @ table / len(table))
    if values[0] < _COPY:
        involved = [name for name, share in zip(names, np.abs(vectors[:, 0]), strict=True) if share > 0.1]
        raise CheckFailed(
            f"{series.file}: the inputs {', '.join(involved)} move together, so their effects can't be told apart; "
            "excite each on its own"
        )
