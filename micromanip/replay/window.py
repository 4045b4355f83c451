"""The part of a recording that another tuning is tried on: rows that track, and the loop's state before them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.states import STAGE, TRACKING

from .recorded import Recorded
from .self_replay import Run

LEAST_S = 0.5
"""A shorter piece says nothing of a tuning."""
_MOST_S = 120.0


@dataclass(frozen=True)
class Window:
    """Rows (n,) of ROW in a row that track; before the first of them stand `state` and `parameters`, each (1,).

    `signals` is the process image then, `samples` (m, MAX_AXES) what the source ``file`` played; `start_s` is the time
    of the first row from the beginning of the recording.
    """

    file: str
    axes: list[str]
    period_ns: int
    configuration: str
    start_s: float
    rows: NDArray[Any] = field(repr=False)
    state: NDArray[Any] = field(repr=False)
    signals: NDArray[Any] = field(repr=False)
    parameters: NDArray[Any] = field(repr=False)
    samples: NDArray[np.float64] = field(repr=False)

    @property
    def seconds(self) -> float:
        """Cycles that were missed within it count."""
        return float(self.rows["periods"].sum()) * self.period_ns * 1e-9


def take_window(telemetry: Telemetry, from_s: float = 0.0, seconds: float | None = None) -> Window:
    """The first piece of a recording that tracks, with its reference in full, from `from_s` on.

    It ends where the cell leaves TRACKING, rows are missing, or after `seconds` (None: two minutes at most). Raises
    CheckFailed where there is none of `LEAST_S`, or what it takes to run the cycle from there is not in the file.
    """
    file, period_s = telemetry.file, telemetry.period_ns * 1e-9
    recorded = Recorded(telemetry)
    first, last, origin = _piece(telemetry, from_s, _MOST_S if seconds is None else seconds)
    if (last - first) * period_s < LEAST_S:
        raise CheckFailed(
            f"{file}: no piece of {LEAST_S:g} s tracks in it from {from_s:g} s on; another tuning is tried on a cell "
            "that follows its reference"
        )
    begun = max((cycle for cycle in recorded.states if cycle < first), default=None)
    if begun is None:
        raise CheckFailed(f"{file}: no state of the loop from before {(first - origin) * period_s:.3f} s is in it")
    run, taken = Run(recorded), []
    for rows in recorded.rows():
        rows = rows[(rows["cycle"] > begun) & (rows["cycle"] <= last)]
        before, inside = rows[rows["cycle"] < first], rows[rows["cycle"] >= first]
        run.go_on(before)
        if len(inside):
            taken.append(inside.copy())
    if (difference := run.outcome.difference) is not None:
        raise CheckFailed(
            f"{file}: from cycle {difference.cycle} on the recording is not what this version computes: "
            f"{difference.cause}; `micromanip replay {file}` shows it"
        )
    state = run.state if run.state is not None else recorded.states.get(begun)
    version = -1 if state is None else int(state["version"][0])
    if state is None or version not in recorded.parameters:
        raise CheckFailed(f"{file}: {run.outcome.gaps[0] if run.outcome.gaps else 'parameters are not in it'}")
    parameters = recorded.parameters[version]
    _require_stage(telemetry, parameters)
    rows = np.concatenate(taken)
    start_s = (int(rows["cycle"][0]) - origin) * period_s
    return Window(
        str(file), telemetry.axes, telemetry.period_ns, telemetry.configuration, start_s, np.ascontiguousarray(rows),
        state, run.signals, parameters, recorded.samples,
    )  # fmt: skip


def _piece(telemetry: Telemetry, from_s: float, seconds: float) -> tuple[int, int, int]:
    """First and last cycle of the first piece that is long enough, else of the longest; and the recording's first."""
    per_s = 1e9 / telemetry.period_ns
    found, origin = (0, 0), None
    for first, last, begin in _pieces(telemetry):
        origin = begin
        first = max(first, begin + round(from_s * per_s))
        last = min(last, first + round(seconds * per_s) - 1)
        if last - first > found[1] - found[0]:
            found = (first, last)
        if last - first >= LEAST_S * per_s:
            break
    return (*found, origin or 0)


def _pieces(telemetry: Telemetry) -> Iterator[tuple[int, int, int]]:
    """First and last cycle of each piece without a gap that tracks, and the first cycle of all."""
    cycle, periods, state = (telemetry.column(name) for name in ("cycle", "periods", "state"))
    tracks = state == TRACKING
    follows = np.append(False, np.diff(cycle) == periods[1:]) & np.append(False, tracks[:-1])
    starts = np.flatnonzero(tracks & ~follows)
    ends = np.flatnonzero(tracks & ~np.append(follows[1:] & tracks[1:], False)) + 1
    for begin, end in zip(starts, ends, strict=True):
        yield int(cycle[begin]), int(cycle[end - 1]), int(cycle[0])


def _require_stage(telemetry: Telemetry, parameters: NDArray[Any]) -> None:
    for name, axis in zip(telemetry.axes, parameters[0]["axis"], strict=False):
        if axis["mode"] != STAGE:
            raise CheckFailed(
                f"{telemetry.file}: axis {name} was not in mode: stage; another tuning is tried on a stage that is "
                "held on its path"
            )
