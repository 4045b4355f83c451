"""A recording for identification: one input and one output, judged before a fit; columns that stand still, refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Recording, Wanted, take
from micromanip.recordings.spikes import bridged, runs

_CLEARLY = 0.5
"""Correlation."""


def stands_still(values: NDArray[np.float64]) -> bool:
    """Whether `values` (n,) are one value, to rounding."""
    return bool(np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())))


def moves_against(values: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether `values` (n,) fall while `other` (n,), which moves, rises."""
    return not stands_still(values) and float(np.corrcoef(values, other)[0, 1]) < -_CLEARLY


def require_movement(file: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    """Refuse columns that stand still."""
    for name, values in columns.items():
        if stands_still(values):
            raise CheckFailed(
                f"{file}: {name} is constant: record while the actuator moves over the stroke that it will use"
            )


Array = NDArray[np.float64]

_LEAST_SAMPLES = 200
_CLIPPED_RUN, _CLIPPED_CODES = 8, 4.0
_CLIPPED = ((0.0, 0.01, "at"), (0.002, 0.05, "near"))
"""Within this share of its stroke, none or that of the noise added behind what clips, the output rests while the input
goes on outwards by that share of its own, and by more than some steps of the sensor show at the top of a slow movement.
Behind a turn, where a hysteresis may rest, it is not looked at."""
_LONGEST_GAP = 0.1
"""Share of a record that may be missing at one place; beyond that the longest piece is used alone."""
_SHORT_GAP = 10
"""Samples that may be missing without a new burn-in: the input has hardly moved meanwhile."""


@dataclass(frozen=True)
class Record:
    """Input (n,) and output (n,) sampled every `step_s`, and where they came from.

    `counts` (n,) is false where the output was not measured, or is wrong: those samples carry the model's memory across
    a gap and are not fitted to. `after_gap` are the first samples behind the longer gaps. `units` are those that were
    stated, turned into V and um.
    """

    file: Path
    input_name: str
    output_name: str
    u: Array
    y: Array
    step_s: float
    counts: NDArray[np.bool_] | None = None
    after_gap: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    told: str = ""
    units: tuple[str | None, ...] = (None, None)

    def burn_in(self, seconds: float) -> int:
        """Samples that do not count; CheckFailed where too few would be left."""
        samples = round(seconds / self.step_s)
        if len(self.u) - samples < _LEAST_SAMPLES:
            raise CheckFailed(
                f"{self.file}: {len(self.u)} samples less {samples} of burn-in are too few to fit to: record at least "
                f"{_LEAST_SAMPLES} more, several periods of the slowest movement"
            )
        return samples

    def weights(self, burn_in: int) -> Array:
        """1 for each sample (n,) that counts: after the `burn_in` samples at the start and behind each longer gap."""
        counted = np.ones(len(self.u)) if self.counts is None else self.counts.astype(float)
        for first in (0, *self.after_gap):
            counted[first : first + burn_in] = 0.0
        return counted


def load_record(file: Path, wanted: Wanted) -> Record:
    """Read and judge the two columns of `wanted`, input and output, of a recording of any kind: (n,) in V and um.

    Raises CheckFailed, with what to record instead, for data that can't be used, UsageError for wrong names.
    """
    taken = take(file, wanted)
    record = _on_the_grid(taken)
    judge_record(record)
    return record


def _on_the_grid(taken: Recording) -> Record:
    """The record with its missing samples as samples that don't count: the input goes straight from side to side."""
    notes = list(taken.notes)
    index, values, spikes = taken.index, taken.values, taken.spikes
    longest = max(_LONGEST_GAP * len(index), _SHORT_GAP)
    pieces = [0, *(np.flatnonzero(np.diff(index) > longest) + 1).tolist(), len(index)]
    if len(pieces) > 2:
        first, last = max(pairwise(pieces), key=lambda piece: piece[1] - piece[0])
        notes.append(f"the gap is too long to go on behind it: only the longest piece is used, {last - first} samples")
        index, values, spikes = index[first:last], values[first:last], spikes[first:last]
    grid = np.arange(int(index[0]), int(index[-1]) + 1)
    counts = np.zeros(len(grid), dtype=bool)
    counts[index - index[0]] = ~spikes.any(axis=1)
    smooth = (bridged(column, flags) for column, flags in zip(values.T, spikes.T, strict=True))
    u, y = (np.interp(grid, index, column) for column in smooth)
    behind = np.flatnonzero(np.diff(index) > _SHORT_GAP) + 1
    after = tuple(int(index[k] - index[0]) for k in behind)
    return Record(
        taken.file,
        taken.names[0],
        taken.names[1],
        u,
        y,
        taken.step_s,
        None if counts.all() else counts,
        after,
        tuple(notes),
        taken.summary(),
        taken.units,
    )


def judge_record(record: Record) -> None:
    """Raise for a record that no hysteresis model can be fitted to."""
    file = record.file
    if len(record.u) < _LEAST_SAMPLES:
        raise CheckFailed(f"{file}: {len(record.u)} samples are too few; record at least {_LEAST_SAMPLES}")
    require_movement(file, {record.input_name: record.u, record.output_name: record.y})
    _judge_clipping(record)
    _judge_movement(record)


def _judge_clipping(record: Record) -> None:
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
                f"{record.file}: {record.output_name} sticks {where} its {end} value {limit:.6g}{noise} for {samples} "
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


def _judge_movement(record: Record) -> None:
    """The output must follow the input, rising with it, and lag behind it."""
    u, y = record.u, record.y
    if moves_against(y, u):
        raise CheckFailed(
            f"{record.file}: {record.output_name} falls when {record.input_name} rises: turn the sensor's sign, "
            "or name the right columns"
        )
    correlation = float(np.corrcoef(u, y)[0, 1])
    if correlation < 0.5:
        raise CheckFailed(
            f"{record.file}: {record.output_name} hardly follows {record.input_name} (correlation {correlation:.2f}): "
            "are these the columns of one axis, recorded together?"
        )
    middle = 0.5 * (u.max() + u.min())
    crossings = np.count_nonzero(np.diff(np.sign(u - middle)) != 0)
    if crossings < 4:
        raise CheckFailed(
            f"{record.file}: {record.input_name} passes its middle only {crossings} times: "
            "record at least two full periods"
        )
    # a lagging output encloses area clockwise in the (y, u) plane; swapped columns turn it around
    area = float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(u)) - 0.5 * (y[-1] + y[0]) * (u[-1] - u[0]))
    if area > 1e-3 * crossings / 2 * np.ptp(u) * np.ptp(y):
        raise CheckFailed(
            f"{record.file}: {record.output_name} runs ahead of {record.input_name}: the columns are probably mixed up "
            f"(--input is the voltage, --output the displacement)"
        )
