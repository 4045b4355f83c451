"""The part of a recording that another tuning is tried on: rows that track, and the loop's state before them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, UsageError
from micromanip.recordings import Telemetry
from micromanip.rt.states import READY, STAGE, TRACKING
from micromanip.rt.supervisor import AT_ONCE, MANY, REMEMBERED
from micromanip.settings.check import validate
from micromanip.settings.schema.model import Configuration, Output, Signal
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.text.source import Source

from .recorded import Recorded
from .self_replay import Run, infer_commands


def recorded_configuration(telemetry: Telemetry) -> tuple[Source, Configuration]:
    """What was in force when the recording began; CheckFailed where this version can't read it."""
    source = Source.parse(Path(telemetry.file), telemetry.sure_configuration())
    return source, validate(source)


def require_comparable(recorded: Configuration, other: Configuration, file: Path | str, config: Path | str) -> None:
    """Raise UsageError for the first thing in which `other` is another cell than that of the recording."""
    for what, was, is_ in _facts(recorded, other):
        if was != is_:
            raise UsageError(
                f"{config}: {what} is {_shown(is_)}, in {file} it is {_shown(was)}: another tuning is tried on the "
                "same axes, rate, sensors and units"
            )
    for name, axis in other.axes.items():
        if axis.mode != "stage":
            raise UsageError(f"{config}: axes.{name}.mode is {axis.mode}; only tunings with mode: stage are compared")


def _facts(recorded: Configuration, other: Configuration) -> list[tuple[str, Any, Any]]:
    facts: list[tuple[str, Any, Any]] = [
        ("axes", list(recorded.axes), list(other.axes)),
        ("loop.rate_hz", recorded.loop.rate_hz, other.loop.rate_hz),
        ("frame", recorded.frame, other.frame),
        ("reference.source", _follows(recorded), _follows(other)),
    ]
    for name in recorded.axes:
        keys = [f"{role}_{name}" for role in ("strain", "stage", "deviation", "voltage")]
        facts += [(key, _origin(recorded, key), _origin(other, key)) for key in keys]
        if name in other.axes:
            facts.append((f"axes.{name}.centre_um", recorded.axes[name].centre_um, other.axes[name].centre_um))
    used = {entry.driver for entry in recorded.signals.values()} | {entry.driver for entry in recorded.outputs.values()}
    for name in sorted(used):
        was, is_ = (each.drivers[name].model_dump() if name in each.drivers else {} for each in (recorded, other))
        facts += [(f"drivers.{name}.{key}", was.get(key), is_.get(key)) for key in {**was, **is_}]
    return facts


def _follows(configuration: Configuration) -> str:
    return "signal" if isinstance(configuration.reference, Tracker) else "its own"


def _origin(configuration: Configuration, name: str) -> str | None:
    """Driver and channel of a signal or an output."""
    entry: Signal | Output | None = configuration.signals.get(name, configuration.outputs.get(name))
    return None if entry is None else f"{entry.driver}:{entry.channel or name}"


def _shown(value: Any) -> str:
    return "left out" if value is None else f"{value!s:.60}"


LEAST_S = 0.5
"""A shorter piece says nothing of a tuning."""
_MOST_S = 120.0
"""Rows take 5 MB per second."""
_MOST_ARMING_S = 30.0


@dataclass(frozen=True)
class Window:
    """Rows (n,) of ROW, of which those from `first` on track; before all of them stand `state` and `parameters` (1,).

    What comes before `first` is the arming, with its `commands` (n,). `signals` is the process image at the beginning,
    `samples` (m, MAX_AXES) what the source ``file`` played; `start_s` is the time of the first row in the recording.
    """

    file: str
    axes: list[str]
    period_ns: int
    configuration: str
    start_s: float
    first: int
    rows: NDArray[Any] = field(repr=False)
    commands: NDArray[np.int64] = field(repr=False)
    state: NDArray[Any] = field(repr=False)
    signals: NDArray[Any] = field(repr=False)
    parameters: NDArray[Any] = field(repr=False)
    samples: NDArray[np.float64] = field(repr=False)

    @property
    def seconds(self) -> float:
        """How long it tracks; cycles that were missed within it count."""
        return float(self.rows["periods"][self.first :].sum()) * self.period_ns * 1e-9

    def at_s(self, row: int) -> float:
        """When `row` was, from the beginning of the recording."""
        passed = int(self.rows["cycle"][row] - self.rows["cycle"][0])
        return self.start_s + passed * self.period_ns * 1e-9


def take_window(telemetry: Telemetry, cut: tuple[float, float] | None = None, *, arming: bool = True) -> Window:
    """The first piece of a recording that tracks.

    Before it stands the arming that led to it where that is in the file and `arming` asks for it, unless `cut` (from,
    to; s from the first row) begins later. It ends where the cell leaves TRACKING, rows are missing, or after two
    minutes. Raises CheckFailed where there is none of `LEAST_S`, or what the cycle needs from there on is not in it.
    """
    file, period_s = telemetry.file, telemetry.period_ns * 1e-9
    recorded = Recorded(telemetry)
    first, last, origin = _piece(telemetry, *(cut or (0.0, np.inf)))
    if (last + 1 - first) * period_s < LEAST_S * (1.0 - 1e-9):
        where = "" if cut is None else f" from {cut[0]:g} to {cut[1]:g} s"
        raise CheckFailed(
            f"{file}: no piece of {LEAST_S:g} s tracks in it{where}; another tuning is tried on a cell that follows "
            "its reference"
        )
    begun = max((cycle for cycle in recorded.states if cycle < first), default=None)
    if begun is None:
        raise CheckFailed(f"{file}: no state of the loop from before {(first - origin) * period_s:.3f} s is in it")
    tracked = first
    if arming and (cut is None or cut[0] == 0.0) and (at_rest := _before_arming(recorded, first, period_s)) is not None:
        begun, first = at_rest, at_rest + 1
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
    rows = np.ascontiguousarray(np.concatenate(taken))
    start_s = (int(rows["cycle"][0]) - origin) * period_s
    commands = infer_commands(rows, state[0], bool(parameters[0]["part"]["signal"] >= 0))
    return Window(
        str(file), telemetry.axes, telemetry.period_ns, telemetry.configuration, start_s,
        int(np.argmax(rows["cycle"] >= tracked)), rows, commands, state, run.signals, parameters, recorded.samples,
    )  # fmt: skip


def _before_arming(recorded: Recorded, first: int, period_s: float) -> int | None:
    """The cycle of the last state at rest before cycle `first`; None where that is long ago, or not in the file."""
    at_rest = [cycle for cycle, state in recorded.states.items() if cycle < first and state["state"][0] == READY]
    begun = max(at_rest, default=None)
    return begun if begun is not None and (first - begun) * period_s <= _MOST_ARMING_S else None


def _piece(telemetry: Telemetry, from_s: float, to_s: float) -> tuple[int, int, int]:
    """First and last cycle of the first piece that is long enough, else of the longest; and the recording's first."""
    per_s = 1e9 / telemetry.period_ns
    found, origin = (0, 0), None
    for first, last, begin in _pieces(telemetry):
        origin = begin
        first = max(first, begin + round(from_s * per_s))
        last = min(last, begin + round(min(to_s, 1e9) * per_s) - 1, first + round(_MOST_S * per_s) - 1)
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


def counted_rows(window: Window, settle: int) -> NDArray[np.bool_]:
    """Which rows (n,) count in figures: tracking for `settle` rows, and as many after the last gap that matters.

    A gap matters with more than `AT_ONCE` cycles, or where the calm gains act for it (``rt/supervisor.py``), from its
    first cycle on. While cycles are missed the voltage stays, and the stage goes where forces and open loop take it:
    what another voltage would have done follows from low frequencies of the actuator, which a closed loop hardly shows.
    The way back then leads over many micrometres, at the limits. So these rows and those within the settling time are
    left out.
    """
    missed = np.maximum(window.rows["periods"].astype(np.int64) - 1, 0)
    many = np.cumsum(np.minimum(missed, AT_ONCE))
    lately = many - np.concatenate([np.zeros(min(REMEMBERED, len(many)), many.dtype), many[:-REMEMBERED]])
    disturbed = (missed > AT_ONCE) | (lately > MANY)
    disturbed[: window.first] = False
    rows = np.arange(len(missed))
    last = np.maximum.accumulate(np.where(disturbed, rows, window.first))
    following = np.minimum.accumulate(np.where(disturbed, rows, len(rows) + REMEMBERED)[::-1])[::-1]
    return (rows > window.first) & (rows >= last + settle) & (rows <= following - REMEMBERED)
