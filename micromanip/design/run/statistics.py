"""What reports keep of a recording: it is read once from its first row to its last, and never held as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.states import TRACKING

from .sums import Counts, Sections, Spectra

BANDS_Hz = ((0.0, 10.0), (10.0, 100.0), (100.0, 1000.0), (1000.0, 5000.0))
_AVERAGED, _SHOWN = 16, 100
"""Cycles in a mean, and between what pictures show."""
TIMING_PERCENT = (50.0, 99.9)
_CELL = ("cycle", "periods", "state", "fault", "lateness_ns", "compute_ns")
_AXIS = ("path_error_um", "voltage_V", "strain_um")
_TOGETHER = 64
"""Pieces of a file that are worked on at a time: some 30,000 rows."""


@dataclass(frozen=True)
class Unread:
    """Cycles that the file has and nobody can read; `first` or `last` is None at an end of the file."""

    first: int | None
    last: int | None
    why: str

    @property
    def cycles(self) -> int:
        """How many; 0 at an end of the file, where nobody knows."""
        return 0 if self.first is None or self.last is None else max(0, self.last - self.first + 1)


@dataclass
class AxisSums:
    """An axis: what needs every cycle while it tracks, and what pictures show of all of the run.

    `squares` are means of the error's, `error` and `left` least and greatest value, `loop` voltage and gauge.
    """

    spectra: Spectra
    squares: Sections = field(default_factory=lambda: Sections(_AVERAGED, _mean))
    error: Sections = field(default_factory=lambda: Sections(_SHOWN, _ends))
    left: Sections = field(default_factory=lambda: Sections(_SHOWN, _ends))
    loop: tuple[Sections, Sections] = field(default_factory=lambda: (_firsts(), _firsts()))
    samples: int = 0
    sum_of_squares: float = 0.0
    greatest_um: float = 0.0
    least_left_V: float = np.inf


@dataclass
class CellSums:
    """The cycles, those `shown`, their timing, and `states`: first and last cycle and the state between them."""

    shown: Sections = field(default_factory=lambda: _firsts())
    first: int = 0
    last: int = 0
    rows: int = 0
    skipped: int = 0
    lost: int = 0
    tracking_cycles: int = 0
    faults: set[int] = field(default_factory=set)
    states: list[tuple[int, int, int]] = field(default_factory=list)
    timing: Mapping[str, Counts] = field(default_factory=lambda: {"lateness": Counts(), "compute": Counts()})


class RecordedRun:
    """A recording that has been read: `cell`, `axis` by name, and what is `unread`."""

    def __init__(self, telemetry: Telemetry, say: Callable[[str], None] = lambda _: None) -> None:
        """`say` hears how far it is. CheckFailed where nothing in it can be read."""
        self.telemetry = telemetry
        self.axes = list(telemetry.axes)
        self.period_s = telemetry.period_ns * 1e-9
        self.unread: list[Unread] = []
        self.cell = CellSums()
        self.axis = {name: AxisSums(Spectra(1.0 / self.period_s, BANDS_Hz)) for name in self.axes}
        for part in self._parts(say):
            self._add(part)
        for each in self.axis.values():
            each.spectra.end()
        self.cell.lost = max(0, self.cell.lost - sum(each.cycles for each in self.unread))

    def at_s(self, cycle: int) -> float:
        """When a cycle was, from the first row."""
        return float(cycle - self.cell.first) * self.period_s

    def voltage_range(self, axis: str) -> tuple[float, float] | None:
        """Between what voltages (V) the limiter keeps an axis; of several sets of parameters the narrowest."""
        place = self.axes.index(axis)
        limits = [each["axis"][0, place]["limiter"] for each in self.telemetry.parameters]
        if not limits:
            return None
        return max(float(one["low_V"]) for one in limits), min(float(one["high_V"]) for one in limits)

    def _parts(self, say: Callable[[str], None]) -> Iterator[dict[str, NDArray[Any]]]:
        """Columns of some pieces at a time; those that can't be read are noted."""
        paths = [*_CELL, *(f"axis.{place}.{name}" for place in range(len(self.axes)) for name in _AXIS)]
        pieces, reading = self.telemetry.pieces(), f"reading {self.telemetry.file.name}"
        held: list[Mapping[str, NDArray[Any]]] = []
        last: int | None = None
        before: int | None = None
        broken = ""
        for number, piece in enumerate(pieces):
            if number % _TOGETHER == 0:
                say(f"{reading}: part {number // _TOGETHER + 1} of {-(-len(pieces) // _TOGETHER)}")
            try:
                columns = piece(paths)
            except CheckFailed as problem:
                broken = broken or str(problem).removeprefix(f"{self.telemetry.file}: ")
                before = last
                continue
            if not len(columns["cycle"]):
                continue
            if broken:
                ends = None if before is None else before + 1, int(columns["cycle"][0]) - 1
                self.unread.append(Unread(*ends, broken))
                broken = ""
            held.append(columns)
            last = int(columns["cycle"][-1])
            if len(held) == _TOGETHER:
                yield _together(held, paths)
                held = []
        if held:
            yield _together(held, paths)
        if broken:
            if last is None:
                raise CheckFailed(f"{self.telemetry.file}: none of its rows can be read: {broken}")
            self.unread.append(Unread(last + 1, None, broken))

    def _add(self, part: Mapping[str, NDArray[Any]]) -> None:
        cell, cycle, periods, state = self.cell, part["cycle"], part["periods"], part["state"]
        before = np.array([cell.last]) if cell.rows else cycle[:1] - periods[:1]
        cell.first = cell.first if cell.rows else int(cycle[0])
        cell.rows += len(cycle)
        cell.skipped += int((periods - 1).clip(0).sum())
        cell.lost += int((np.diff(cycle, prepend=before) - periods).clip(0).sum())
        cell.last = int(cycle[-1])
        cell.faults.update(np.unique(part["fault"]).tolist())
        tracks = np.asarray(state == TRACKING)
        cell.tracking_cycles += int(periods[tracks].sum())
        self._add_states(cycle, state)
        for name, counts in cell.timing.items():
            counts.add(part[f"{name}_ns"])
        cell.shown.add(cycle)
        for place, name in enumerate(self.axes):
            columns = {each: part[f"axis.{place}.{each}"] for each in _AXIS}
            _add_axis(self.axis[name], columns, tracks, self._left(name, columns["voltage_V"]))

    def _left(self, axis: str, voltage_V: Array) -> Array:
        """Voltage to the nearer end of the range; NaN where that is not known."""
        limits = self.voltage_range(axis)
        if limits is None:
            return np.full(len(voltage_V), np.nan)
        return np.asarray(np.minimum(voltage_V - limits[0], limits[1] - voltage_V))

    def _add_states(self, cycle: NDArray[np.int64], state: NDArray[np.int64]) -> None:
        begins = np.flatnonzero(np.diff(state, prepend=-1))
        ends = np.append(begins[1:], len(state)) - 1
        found = [(int(cycle[a]), int(cycle[b]), int(state[a])) for a, b in zip(begins, ends, strict=True)]
        states = self.cell.states
        if states and states[-1][2] == found[0][2]:
            found[0] = (states.pop()[0], *found[0][1:])
        states += found


def _add_axis(axis: AxisSums, part: Mapping[str, Array], tracks: NDArray[np.bool_], left_V: Array) -> None:
    axis.error.add(np.where(tracks, part["path_error_um"], np.nan))
    axis.left.add(left_V)
    error = part["path_error_um"][tracks]
    error = error[np.isfinite(error)]
    if len(error):
        axis.samples += len(error)
        axis.sum_of_squares += float(error @ error)
        axis.greatest_um = max(axis.greatest_um, float(np.abs(error).max()))
        axis.squares.add(error * error)
        axis.spectra.add(error)
    axis.least_left_V = min(axis.least_left_V, float(left_V[tracks & np.isfinite(left_V)].min(initial=np.inf)))
    for sections, name in zip(axis.loop, ("voltage_V", "strain_um"), strict=True):
        sections.add(part[name])


def _together(held: Sequence[Mapping[str, NDArray[Any]]], paths: Sequence[str]) -> dict[str, NDArray[Any]]:
    return {path: np.concatenate([each[path] for each in held]) for path in paths}


def _mean(sections: Array) -> Array:
    return np.asarray(sections.mean(axis=1))


def _firsts() -> Sections:
    return Sections(_SHOWN, lambda sections: sections[:, 0])


def _ends(sections: Array) -> Array:
    """Least and greatest known value (sections, 2)."""
    return np.stack([np.fmin.reduce(sections, axis=1), np.fmax.reduce(sections, axis=1)], axis=1)
