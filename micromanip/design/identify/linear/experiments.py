"""Experiments for a linear fit: columns of recordings, judged before anything is fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.signal import decimate

from micromanip.design.data import require_movement, stands_still
from micromanip.errors import CheckFailed
from micromanip.recordings import Recording, Wanted, take
from micromanip.recordings.loader import LISTS
from micromanip.recordings.spikes import bridged

from .modal import Array, Experiment

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


_LEAP, _QUIET, _FEWEST_LEAPS = 0.5, 0.25, 3
"""Of the stroke: a leap over the whole of it, and what other steps and the input stay below."""


def wrapped(u: Array, y: Array) -> str | None:
    """How an output `y` (n,) leaps between its ends and goes on, as inputs `u` (n, m) don't; None: it does not."""
    stroke = float(np.ptp(y))
    steps = np.diff(y) / stroke
    leaps = np.abs(steps) > _LEAP
    on = np.abs(np.abs(steps[leaps]) - 1.0)
    moved = np.abs(np.diff(u, axis=0))[leaps] / np.ptp(u, axis=0)
    if leaps.sum() < _FEWEST_LEAPS or leaps.mean() > _QUIET or on.max() > _QUIET or np.median(moved) > _QUIET:
        return None
    return None if np.abs(steps[~leaps]).max() > _QUIET else f"leaps {leaps.sum()} times over its whole range"


_LEAST_SAMPLES, _LEAST_PIECE, _FILLED = 200, 100, 3
_SAME_RATE, _WHOLE = 0.01, 0.01
_COPY = 1e-9


@dataclass(frozen=True)
class LinearRecord:
    """Inputs (n, m) and outputs (n, l) sampled every `dt` seconds, and where they came from.

    Samples are missing before each of `breaks`: what is on either side are experiments of their own.
    """

    file: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    u: Array
    y: Array
    dt: float
    breaks: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    told: str = ""
    units: tuple[str | None, ...] = ()

    @property
    def experiments(self) -> list[Experiment]:
        """Inputs and outputs of each part without a gap."""
        ends = [0, *self.breaks, len(self.u)]
        return [(self.u[first:last], self.y[first:last]) for first, last in pairwise(ends)]

    def _part(self, first: int, last: int) -> LinearRecord:
        """Samples `first` up to `last`; pieces that the cut leaves too short are left out."""
        inner = [k for k in self.breaks if first < k < last]
        ends = [first, *inner, last]
        kept = [piece for piece in pairwise(ends) if piece[1] - piece[0] >= min(_LEAST_PIECE, last - first)]
        used = np.concatenate([np.arange(*piece) for piece in kept]) if kept else np.arange(first, last)
        breaks = np.cumsum([end - begin for begin, end in kept])[:-1] if kept else np.array([], dtype=int)
        return replace(self, u=self.u[used], y=self.y[used], breaks=tuple(int(k) for k in breaks))

    def split(self, share: float) -> tuple[LinearRecord, LinearRecord | None]:
        """The first `share` of the record, and the rest, if any. CheckFailed where one of them is too short."""
        count = round(share * len(self.u))
        parts = [(0, count)] if count == len(self.u) else [(0, count), (count, len(self.u))]
        records = [self._part(*part) for part in parts]
        for record in records:
            if len(record.u) < _LEAST_SAMPLES // 2:
                raise CheckFailed(
                    f"{self.file}: split at {share:g}, a part of {len(record.u)} samples is left, which is too short; "
                    f"at least {_LEAST_SAMPLES // 2} are needed"
                )
            still = [
                name
                for names, values in ((self.inputs, record.u), (self.outputs, record.y))
                for name, moved in zip(names, values.T, strict=True)
                if stands_still(moved)
            ]
            if still:
                part = "first" if record is records[0] else "last"
                raise CheckFailed(
                    f"{self.file}: split at {share:g}, {still[0]} stands still in the {part} {len(record.u)} samples: "
                    "split elsewhere, or give --split 1 and with --validate a record that moves, if need be this one"
                )
        return records[0], records[1] if len(records) > 1 else None


def load_linear(file: Path, wanted: Wanted, inputs: int = LISTS) -> LinearRecord:
    """Read the columns of `wanted`: the first `inputs` of them are, the others outputs; or a list of each.

    Its `step_s` is the sampling interval, s, of the model: that of the record's time column, or a whole multiple of it,
    for which the record is low-passed and thinned. Raises CheckFailed, with what to record instead, for data that can't
    be used.
    """
    taken = take(file, replace(wanted, inputs=inputs))
    inputs = taken.inputs or inputs
    if len(taken.values) < _LEAST_SAMPLES:
        raise CheckFailed(f"{file}: {len(taken.values)} samples are too few; record at least {_LEAST_SAMPLES}")
    columns = dict(zip(taken.names, taken.values.T, strict=True))
    require_movement(file, columns)
    _require_different(file, {name: columns[name] for name in taken.names[:inputs]})
    dt = taken.step_s if wanted.step_s is None or wanted.rate_hz is not None else wanted.step_s
    thin = _thinning(file, taken.step_s, dt)
    pieces, notes = _pieces(taken)
    notes += _clipping(np.concatenate(pieces), taken.names, inputs)
    notes += [
        f"{name} {how} while the input moves little: if it is a counter that wraps, make it go on, numpy.unwrap"
        for name, y in zip(taken.names[inputs:], taken.values.T[inputs:], strict=True)
        if (how := wrapped(taken.values[:, :inputs], y)) is not None
    ]
    if thin > 1:
        # all go through the same filter, which so cancels in the model
        pieces = [np.asarray(decimate(piece, thin, ftype="fir", axis=0)) for piece in pieces]
    values = np.concatenate(pieces)
    breaks = tuple(int(k) for k in np.cumsum([len(piece) for piece in pieces])[:-1])
    u, y = values[:, :inputs], values[:, inputs:]
    return LinearRecord(
        file, taken.names[:inputs], taken.names[inputs:], u, y, dt, breaks, tuple(notes), taken.summary(), taken.units
    )


def _pieces(taken: Recording) -> tuple[list[Array], list[str]]:
    """The parts (n, columns) without a gap that are long enough to be used, spikes bridged, and what is to be told."""
    smooth = np.column_stack(
        [bridged(column, flags) for column, flags in zip(taken.values.T, taken.spikes.T, strict=True)]
    )
    pieces, index, notes = [smooth[part] for part in taken.pieces], taken.index, list(taken.notes)
    if sum(len(piece) for piece in pieces if len(piece) >= _LEAST_PIECE) < 0.5 * len(smooth):
        short_gaps = np.diff(index) <= _FILLED + 1
        ends = [0, *(np.flatnonzero(~short_gaps) + 1).tolist(), len(index)]
        grids = [np.arange(index[first], index[last - 1] + 1) for first, last in pairwise(ends)]
        pieces = [np.column_stack([np.interp(grid, index, column) for column in smooth.T]) for grid in grids]
        notes.append(
            f"of the missing samples {sum(map(len, grids)) - len(index)}, in gaps of at most {_FILLED}, are filled in "
            "along straight lines, as the parts between are too short to be fitted to: fast dynamics are blurred"
        )
    long = [piece for piece in pieces if len(piece) >= _LEAST_PIECE]
    if sum(len(piece) for piece in long) < _LEAST_SAMPLES:
        raise CheckFailed(
            f"{taken.file}: of {len(pieces)} parts between gaps the longest has "
            f"{max(len(piece) for piece in pieces)} samples, which is too short; record without gaps, "
            f"at least {_LEAST_SAMPLES} samples"
        )
    short = len(pieces) - len(long)
    told = [f"{short} of {len(pieces)} parts between gaps are shorter than {_LEAST_PIECE} samples and are left out"]
    return long, [*notes, *(told if short else [])]


def _clipping(values: Array, names: Sequence[str], inputs: int) -> list[str]:
    """What is to be told of outputs, the columns of `values` (n, columns) behind the `inputs`, that look clipped."""
    return [
        f"{name} {how} while the input moves: where the sensor is clipped, poles and gains are not the plant's; "
        "shift its range, or record a smaller movement"
        for name, y in zip(names[inputs:], values[:, inputs:].T, strict=True)
        if (how := clipped(values[:, :inputs], y)) is not None
    ]


def _thinning(file: Path, step: float, dt: float) -> int:
    ratio = dt / step
    if abs(ratio - round(ratio)) > _WHOLE * ratio or round(ratio) < 1:
        raise CheckFailed(
            f"{file}: --dt {dt:.6g} s is no whole multiple of the record's sampling interval, {step:.6g} s"
        )
    return round(ratio)


def _require_different(file: Path, columns: dict[str, Array]) -> None:
    """Inputs that are copies of one another can't be told apart."""
    names = list(columns)
    table = np.column_stack(list(columns.values()))
    table = (table - table.mean(axis=0)) / table.std(axis=0)
    values, vectors = np.linalg.eigh(table.T @ table / len(table))
    if values[0] < _COPY:
        involved = [name for name, share in zip(names, np.abs(vectors[:, 0]), strict=True) if share > 0.1]
        raise CheckFailed(
            f"{file}: the inputs {', '.join(involved)} move together, so their effects can't be told apart; "
            "excite each on its own"
        )


def same_rate(records: Sequence[LinearRecord]) -> None:
    """CheckFailed unless all records are sampled alike."""
    first = records[0]
    for other in records[1:]:
        if abs(other.dt / first.dt - 1.0) > _SAME_RATE:
            raise CheckFailed(
                f"{other.file}: sampled every {other.dt:.6g} s, {first.file} every {first.dt:.6g} s; "
                "record all at one rate"
            )
