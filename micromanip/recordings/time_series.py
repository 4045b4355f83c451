"""A piece of recorded data: columns with units on a grid, what is missing or wrong in them, where they came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .spikes import bridged
from .table import Array
from .units import known, split_unit


@dataclass(frozen=True)
class TimeSeries:
    """Columns (n, k) sampled every `step_s`, s; the first `inputs` of them drive the others.

    `index` (n,) is each row's number on the grid: where it leaps, rows are missing. `doubtful` (n, k) marks what was
    not measured: spikes, and what was filled in. `units` are um, V, s and the like, None where none was stated. `told`
    says in a line what was taken of `file`, `notes` what is unusual.
    """

    file: Path
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    values: Array
    step_s: float
    index: NDArray[np.int64]
    doubtful: NDArray[np.bool_]
    inputs: int = 1
    notes: tuple[str, ...] = ()
    told: str = ""

    @classmethod
    def of_columns(cls, file: Path, columns: Mapping[str, Array], step_s: float, inputs: int = 1) -> TimeSeries:
        """Columns (n,) without a gap, in the units of their names."""
        values = np.column_stack(list(columns.values()))
        units = (known(split_unit(name)[1] or "") for name in columns)
        return cls(
            file, tuple(columns), tuple(unit.base if unit else None for unit in units), values, step_s,
            np.arange(len(values)), np.zeros(values.shape, bool), inputs,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, name: str) -> Array:
        return self.values[:, self.names.index(name)]

    @property
    def u(self) -> Array:
        """The first input (n,)."""
        return self.values[:, 0]

    @property
    def y(self) -> Array:
        """The first output (n,)."""
        return self.values[:, self.inputs]

    @property
    def time_s(self) -> Array:
        """Time (n,) from the first row."""
        return np.asarray((self.index - self.index[0]) * self.step_s, dtype=float)

    def parts(self, missing: float = 0) -> list[slice]:
        """The parts in which at most so many rows are missing at a place."""
        ends = [0, *(np.flatnonzero(np.diff(self.index) > missing + 1) + 1).tolist(), len(self)]
        return [slice(first, last) for first, last in pairwise(ends)]

    @property
    def experiments(self) -> list[tuple[Array, Array]]:
        """Inputs (n, inputs) and outputs (n, k - inputs) of each part without a gap."""
        return [(self.values[part, : self.inputs], self.values[part, self.inputs :]) for part in self.parts()]

    def rows(self, which: slice | NDArray[np.int64]) -> TimeSeries:
        """These rows alone."""
        return replace(self, values=self.values[which], index=self.index[which], doubtful=self.doubtful[which])

    def bridged(self) -> TimeSeries:
        """With straight lines over what is doubtful."""
        columns = zip(self.values.T, self.doubtful.T, strict=True)
        return replace(self, values=np.column_stack([bridged(column, flags) for column, flags in columns]))

    def filled(self) -> TimeSeries:
        """With straight lines over gaps and what is doubtful: every row is there, those put in are doubtful."""
        grid = np.arange(int(self.index[0]), int(self.index[-1]) + 1)
        doubtful = np.ones((len(grid), len(self.names)), dtype=bool)
        doubtful[self.index - grid[0]] = self.doubtful
        values = np.column_stack([np.interp(grid, self.index, column) for column in self.bridged().values.T])
        return replace(self, values=values, index=grid, doubtful=doubtful)


def joined(parts: Sequence[TimeSeries]) -> TimeSeries:
    """The rows of several parts of one recording, one after the other."""
    columns = zip(*((part.values, part.index, part.doubtful) for part in parts), strict=True)
    values, index, doubtful = map(np.concatenate, columns)
    return replace(parts[0], values=values, index=index, doubtful=doubtful)


_TAPS = 10
"""Half length of the low-pass, in samples of the result."""
_PASSED = 0.8
"""Edge of the low-pass, share of half the new rate."""
_SHORT = 1.5
"""Steps of the grid from which on there is a gap between two rows."""


def resampled(series: TimeSeries, step_s: float, at: Array | None = None, gap: float = _SHORT) -> TimeSeries:
    """Every `step_s`, by monotone cubics, part by part; low-passed first where that is longer.

    `at` (n,) are the rows' places in steps of `series`, where they are beside its grid; `gap` parts them.
    """
    from scipy.interpolate import PchipInterpolator

    ratio, parts = step_s / series.step_s, []
    places = series.index.astype(float) if at is None else at
    for piece in np.split(np.arange(len(series)), np.flatnonzero(np.diff(places) > gap) + 1):
        if len(piece) < 2:
            continue
        values, own = series.values[piece], places[piece]
        grid = np.arange(int(np.ceil(own[0] / ratio - 1e-9)), int(np.floor(own[-1] / ratio + 1e-9)) + 1)
        where = np.clip(grid * ratio, own[0], own[-1])
        nearest = np.clip(np.searchsorted(own, where), 1, len(own) - 1)
        doubtful = series.doubtful[piece]
        values = np.asarray(PchipInterpolator(own, _low_passed(values, ratio) if ratio > 1.0 else values)(where))
        parts.append(replace(series, values=values, index=grid, doubtful=doubtful[nearest] | doubtful[nearest - 1]))
    return replace(joined(parts), step_s=step_s)


def _low_passed(values: Array, ratio: float) -> Array:
    """Without delay; what lies before and behind is continued through the ends."""
    from scipy.signal import firwin

    half = min(int(np.ceil(_TAPS * ratio)), len(values) - 1)
    taps = firwin(2 * half + 1, _PASSED / ratio)
    ahead, behind = 2 * values[:1] - values[half:0:-1], 2 * values[-1:] - values[-2 : -half - 2 : -1]
    long = np.vstack([ahead, values, behind])
    return np.column_stack([np.convolve(column, taps, "valid") for column in long.T])
