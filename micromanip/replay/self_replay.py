"""The recorded run once more, row by row, until one differs or something is missing; which commands that took."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.recordings.file_header import sources_of_cycle
from micromanip.rt import states
from micromanip.rt.records import CELL_PARAMETERS, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.telemetry import PART_RUNS, PART_TURN, ROW

from .kernel import NO_SWAP, NOTHING_DIFFERS, SWAP_AFTER, SWAP_BEFORE, replay_rows
from .recorded import Recorded

_SENSORS = ("fresh", "strain_um", "stage_um", "deviation_um", "strain_age_ns", "stage_age_ns", "deviation_age_ns")
_CELL = ("cycle", "state", "phase", "fault", "version", "lines")
_LAW = (
    "reference_um", "estimate_um", "innovation_um", "setpoint_um", "feedforward_V", "notch_um", "feedback_V",
    "voltage_V", "path_error_um", "uncompensated_um", "conditions",
)  # fmt: skip


class Value(NamedTuple):
    """A number of one row as it was recorded and as it came again; `axis` is empty where it is the cell's."""

    name: str
    axis: str
    recorded: float
    replayed: float


@dataclass(frozen=True)
class Mismatch:
    """Row `at` of a part is the first that differs, in `values`: what the cycle computes first comes first."""

    at: int
    values: list[Value]


def first_mismatch(recorded: NDArray[Any], replayed: NDArray[Any], axes: list[str]) -> Mismatch | None:
    """The first of the rows (n,) that are not the same; None where all are."""
    differs = np.zeros(len(recorded), bool)
    columns = [(name, "", *_pair(recorded, replayed, name)) for name in _CELL[:1]]
    for names in (_SENSORS, _LAW):
        for k, axis in enumerate(axes):
            one, two = recorded["axis"][:, k], replayed["axis"][:, k]
            columns += [(name, axis, *_pair(one, two, name)) for name in names]
        if names is _SENSORS:
            columns += [(name, "", *_pair(recorded, replayed, name)) for name in _CELL[1:]]
    for _, _, one, two in columns:
        differs |= _unequal(one, two)
    if not differs.any():
        return None
    at = int(np.argmax(differs))
    found = [
        Value(name, axis, one[at].item(), two[at].item())
        for name, axis, one, two in columns
        if _unequal(one[at : at + 1], two[at : at + 1])[0]
    ]
    return Mismatch(at, found)


def _pair(one: NDArray[Any], two: NDArray[Any], name: str) -> tuple[NDArray[Any], NDArray[Any]]:
    return np.ascontiguousarray(one[name]), np.ascontiguousarray(two[name])


def _unequal(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.bool_]:
    """By the bits; no number is as good as no number."""
    if one.dtype.kind != "f":
        return np.asarray(one != two)
    return np.asarray((one.view(np.int64) != two.view(np.int64)) & ~(np.isnan(one) & np.isnan(two)))


@dataclass(frozen=True)
class Difference:
    """The first row that is another one."""

    cycle: int
    t_s: float
    """From the first recorded cycle on."""
    values: list[Value]
    cause: str


@dataclass
class ReplayResult:
    """What was replayed, and what came of it."""

    axes: list[str]
    rows: int = 0
    """In the recording."""
    left_out: int = 0
    """Rows that could not be replayed: they follow no state of the loop."""
    cycles: int = 0
    """Replayed, and bit for bit the same."""
    skipped: int = 0
    """Cycles that the loop missed within them."""
    swaps: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    is_other_version: bool = False
    """Whether the sources of the cycle have changed since it was recorded."""
    gaps: list[str] = field(default_factory=list)
    """What was missing; behind it the replay began anew from the next state of the loop."""
    difference: Difference | None = None


def replay(telemetry: Telemetry) -> ReplayResult:
    """Run the cycles of a recording again, as far as it says what came in.

    Raises CheckFailed where it lacks what the first of them needs, or is damaged.
    """
    recorded = Recorded(telemetry)
    run = Run(recorded)
    for rows in recorded.rows():
        run.outcome.rows += len(rows)
        run.go_on(rows)
    if run.outcome.cycles == 0 and run.outcome.difference is None:
        why = run.outcome.gaps or ["no row follows a state of the loop"]
        raise CheckFailed(f"{telemetry.file}: nothing can be replayed: {why[0]}")
    return run.outcome


class Run:
    """The cell as it goes through the rows."""

    def __init__(self, recorded: Recorded) -> None:
        telemetry = recorded.telemetry
        self.recorded = recorded
        self.state: NDArray[Any] | None = None
        self.signals, self.outputs = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS)
        self.sets = np.zeros(2, CELL_PARAMETERS)
        self.outcome = ReplayResult(telemetry.axes, is_other_version=telemetry.sources != sources_of_cycle())
        self._first_cycle: int | None = None

    def go_on(self, rows: NDArray[Any]) -> None:
        """Replay `rows`, up to the first that differs, from the first on that follows a state of the loop."""
        if self._first_cycle is None and len(rows):
            self._first_cycle = int(rows["cycle"][0])
        while len(rows) and self.outcome.difference is None:
            if self.state is None:
                rows = self._begin(rows)
                continue
            behind = np.append(self.state["cycle"][0], rows["cycle"][:-1])
            broken = np.flatnonzero(rows["cycle"] - behind != rows["periods"])
            whole = int(broken[0]) if len(broken) else len(rows)
            for part in np.split(rows[:whole], np.flatnonzero(np.diff(rows["version"][:whole])) + 1):
                if self.state is None:
                    self.outcome.left_out += len(part)
                elif len(part) and self.outcome.difference is None:
                    self._one_version(self.state, np.ascontiguousarray(part))
            if len(broken) and self.state is not None and self.outcome.difference is None:
                missing = int(rows["cycle"][whole] - behind[whole] - rows["periods"][whole])
                self.outcome.gaps.append(
                    f"{missing} cycles are missing behind cycle {behind[whole]}"
                    if missing > 0
                    else f"cycle {rows['cycle'][whole]} comes behind cycle {behind[whole]}"
                )
                self.state = None
            rows = rows[whole:]

    def _begin(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Take the state that one of `rows` follows; those from this row on."""
        follows = np.isin(rows["cycle"] - rows["periods"], list(self.recorded.states))
        at = int(np.argmax(follows)) if follows.any() else len(rows)
        self.outcome.left_out += at
        if at < len(rows):
            self.state = self.recorded.states[int(rows["cycle"][at] - rows["periods"][at])].copy()
            self.signals[:] = np.zeros(1, SIGNAL)
        return rows[at:]

    def _one_version(self, state: NDArray[Any], rows: NDArray[Any]) -> None:
        version, present = int(rows["version"][0]), int(state["version"][0])
        for needed in (present, version):
            if needed not in self.recorded.parameters:
                cycle = rows["cycle"][0]
                self.outcome.gaps.append(f"the parameters of version {needed}, needed in cycle {cycle}, are not in it")
                self.outcome.left_out += len(rows)
                self.state = None
                return
        self.sets[0], self.sets[1] = self.recorded.parameters[present][0], self.recorded.parameters[version][0]
        if version != present:
            self._swap(state, rows[:1])
            self.sets[0], rows = self.sets[1].copy(), rows[1:]
        if len(rows) and self.outcome.difference is None:
            self._count(rows, *self._replayed(state, rows, NO_SWAP))

    def _swap(self, state: NDArray[Any], row: NDArray[Any]) -> None:
        """The row in which other parameters came: at the boundary before it, or as a promotion behind it."""
        self.outcome.swaps += 1
        was = state.copy(), self.signals.copy()
        found = self._replayed(state, row, SWAP_BEFORE)
        if found[0] is not None:
            state[:], self.signals[:] = was
            again = self._replayed(state, row, SWAP_AFTER)
            found = again if again[0] is None else found
        self._count(row, *found)

    def _replayed(
        self, state: NDArray[Any], rows: NDArray[Any], swap: int
    ) -> tuple[Mismatch | None, NDArray[np.int64]]:
        commands = infer_commands(rows, state[0], bool(self.sets[0]["part"]["signal"] >= 0))
        replayed = np.zeros(len(rows), ROW)
        samples = self.recorded.samples
        whole = swap, len(rows)
        replay_rows(
            self.sets, state, self.signals, self.outputs, samples, rows, commands, replayed, *whole, *NOTHING_DIFFERS
        )
        return first_mismatch(rows, replayed, self.outcome.axes), commands

    def _count(self, rows: NDArray[Any], mismatch: Mismatch | None, commands: NDArray[np.int64]) -> None:
        good = len(rows) if mismatch is None else mismatch.at
        self.outcome.cycles += good
        self.outcome.skipped += int((rows["periods"][:good] - 1).sum())
        self.outcome.commands.update(states.COMMAND_NAMES[k] for k in commands[:good] if k != states.NO_COMMAND)
        if mismatch is not None:
            cycle = int(rows["cycle"][mismatch.at])
            t_s = (cycle - (self._first_cycle or 0)) * self.recorded.telemetry.period_ns * 1e-9
            self.outcome.difference = Difference(cycle, t_s, mismatch.values, self._cause(mismatch))

    def _cause(self, mismatch: Mismatch) -> str:
        """What most likely made them differ."""
        if self.outcome.is_other_version:
            return "another version of the program recorded it: the sources of its cycle are not those of this one"
        if mismatch.values[0].name in ("state", "phase", "fault"):
            return "something led to another state that the rows do not say"
        return (
            "the same sources compute something else here: a row was changed, or another processor or mathematical "
            "library rounds differently"
        )


_ALWAYS = {
    (states.READY, states.ARMING): states.ARM,
    (states.HOLDING, states.ARMING): states.ARM,
    (states.FAULT, states.READY): states.RESET,
    (states.READY, states.OFF): states.STOP,
    (states.FAULT, states.OFF): states.STOP,
    (states.RAMPING, states.OFF): states.STOP,
}
_WITHOUT_A_NEW_FAULT = {
    (states.TRACKING, states.HOLDING): states.HOLD,
    (states.ARMING, states.HOLDING): states.HOLD,
    (states.TRACKING, states.RAMPING): states.DISARM,
    (states.ARMING, states.RAMPING): states.DISARM,
    (states.HOLDING, states.RAMPING): states.DISARM,
}


def infer_commands(rows: NDArray[Any], before: Any, wired: bool) -> NDArray[np.int64]:
    """The command (n,) of each of the `rows` (n,); `before` is the cell's state before them.

    `wired`: a signal says which part is made, not a command.
    """
    commands = np.full(len(rows), states.NO_COMMAND, np.int64)
    entered, faults = np.append(before["state"], rows["state"]), np.append(before["fault"], rows["fault"])
    for k in np.flatnonzero(np.diff(entered)):
        change = (int(entered[k]), int(entered[k + 1]))
        commands[k] = _ALWAYS.get(change, states.NO_COMMAND)
        if faults[k + 1] in (states.NO_FAULT, faults[k]):
            commands[k] = _WITHOUT_A_NEW_FAULT.get(change, commands[k])
    if not wired:
        runs = np.append(before["part"] != 0, rows["lines"] & PART_RUNS != 0)
        turn = np.append(before["parts"] % 2 != 0, rows["lines"] & PART_TURN != 0)
        commands[runs[:-1] & ~runs[1:] & (entered[1:] == states.TRACKING)] = states.END_PART
        commands[turn[:-1] != turn[1:]] = states.BEGIN_PART
    return commands
