"""The recorded run once more, row by row, until one differs or something is missing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.recordings.filed import sources_of_cycle
from micromanip.rt.records import CELL_PARAMETERS, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.states import COMMAND_NAMES, NO_COMMAND
from micromanip.rt.telemetry import ROW

from .commands import commands_of
from .comparison import Unequal, Value, first_unequal
from .kernel import NO_SWAP, SWAP_AFTER, SWAP_BEFORE, replay_rows
from .recorded import Recorded


@dataclass(frozen=True)
class Difference:
    """The first row that is another one."""

    cycle: int
    t_s: float
    """From the first recorded cycle on."""
    values: list[Value]
    cause: str


@dataclass
class Outcome:
    """What was replayed, and what came of it."""

    axes: list[str]
    rows: int = 0
    """In the recording."""
    before: int = 0
    """Rows that were recorded before the loop's state."""
    cycles: int = 0
    """Replayed, and bit for bit the same."""
    skipped: int = 0
    """Cycles that the loop missed within them."""
    swaps: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    lacks: list[str] = field(default_factory=list)
    sources: str = ""
    is_other_version: bool = False
    ended: str | None = None
    """Why nothing behind them could be replayed."""
    difference: Difference | None = None


def replay(telemetry: Telemetry) -> Outcome:
    """Run the cycles of a recording again, as far as it says what came in.

    Raises CheckFailed where it lacks what the first of them needs, or is damaged.
    """
    recorded = Recorded(telemetry)
    run = _Run(recorded)
    for rows in recorded.rows():
        run.outcome.rows += len(rows)
        if not run.is_over:
            run.go_on(rows)
    run.outcome.lacks = recorded.lacks
    if run.outcome.cycles == 0 and run.outcome.difference is None:
        raise CheckFailed(
            f"{telemetry.file}: nothing can be replayed: "
            + (run.outcome.ended or f"no row follows the loop's state, cycle {recorded.state['cycle'][0]}")
        )
    return run.outcome


class _Run:
    """The cell as it goes through the rows."""

    def __init__(self, recorded: Recorded) -> None:
        telemetry = recorded.telemetry
        self.recorded, self.state = recorded, recorded.state.copy()
        self.signals, self.outputs = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS)
        self.sets = np.zeros(2, CELL_PARAMETERS)
        self.outcome = Outcome(telemetry.axes, sources=telemetry.sources)
        self.outcome.is_other_version = telemetry.sources not in ("", sources_of_cycle()) or bool(recorded.unlike)
        self._first_cycle: int | None = None
        self._version: int | None = None

    @property
    def is_over(self) -> bool:
        return self.outcome.ended is not None or self.outcome.difference is not None

    def go_on(self, rows: NDArray[Any]) -> None:
        """Replay `rows`, up to the first that differs or can't be."""
        if not len(rows):
            return
        if self._first_cycle is None:
            self._first_cycle = int(rows["cycle"][0])
        later = rows["cycle"] > self.state["cycle"][0]
        if self.outcome.cycles == 0:
            self.outcome.before += int(np.count_nonzero(~later))
            rows = rows[later]
        if not len(rows):
            return
        behind = np.append(self.state["cycle"][0], rows["cycle"][:-1])
        broken = np.flatnonzero(rows["cycle"] - behind != rows["periods"])
        whole = rows[: broken[0]] if len(broken) else rows
        for part in np.split(whole, np.flatnonzero(np.diff(whole["version"])) + 1):
            if len(part) and not self.is_over:
                self._one_version(np.ascontiguousarray(part))
        if len(broken) and not self.is_over:
            at = int(broken[0])
            missing = int(rows["cycle"][at] - behind[at] - rows["periods"][at])
            self.outcome.ended = (
                f"{missing} cycles are missing behind cycle {behind[at]}"
                if missing > 0
                else f"cycle {rows['cycle'][at]} comes behind cycle {behind[at]}"
            )

    def _one_version(self, rows: NDArray[Any]) -> None:
        version = int(rows["version"][0])
        if version not in self.recorded.parameters:
            self.outcome.ended = f"the parameters of version {version}, from cycle {rows['cycle'][0]} on, are not in it"
            return
        present = int(self.state["version"][0])
        if self._version is None and present not in self.recorded.parameters:
            self.outcome.ended = f"the parameters of version {present}, those of the loop's state, are not in it"
            return
        self._version = version
        self.sets[0] = self.recorded.parameters[version][0]
        if version != present:
            self.sets[0], self.sets[1] = self.recorded.parameters[present][0], self.sets[0].copy()
            self._swap(rows[:1])
            self.sets[0], rows = self.sets[1].copy(), rows[1:]
        if len(rows) and not self.is_over:
            self._count(rows, *self._tried(rows, NO_SWAP))

    def _swap(self, row: NDArray[Any]) -> None:
        """The row in which other parameters came: at the boundary before it, or as a promotion behind it."""
        self.outcome.swaps += 1
        state, signals = self.state.copy(), self.signals.copy()
        found = self._tried(row, SWAP_BEFORE)
        if found[0] is not None:
            after = self.state.copy(), self.signals.copy()
            self.state, self.signals = state, signals
            again = self._tried(row, SWAP_AFTER)
            if again[0] is None:
                found = again
            else:
                self.state, self.signals = after
        self._count(row, *found)

    def _tried(self, rows: NDArray[Any], swap: int) -> tuple[Unequal | None, NDArray[np.int64]]:
        commands = commands_of(rows, int(self.state["state"][0]), int(self.state["fault"][0]))
        replayed = np.zeros(len(rows), ROW)
        samples = self.recorded.samples
        replay_rows(self.sets, self.state, self.signals, self.outputs, samples, rows, commands, replayed, swap)
        return first_unequal(rows, replayed, self.outcome.axes), commands

    def _count(self, rows: NDArray[Any], unequal: Unequal | None, commands: NDArray[np.int64]) -> None:
        good = len(rows) if unequal is None else unequal.at
        self.outcome.cycles += good
        self.outcome.skipped += int((rows["periods"][:good] - 1).sum())
        self.outcome.commands.update(COMMAND_NAMES[k] for k in commands[:good] if k != NO_COMMAND)
        if unequal is not None:
            cycle = int(rows["cycle"][unequal.at])
            t_s = (cycle - (self._first_cycle or 0)) * self.recorded.telemetry.period_ns * 1e-9
            self.outcome.difference = Difference(cycle, t_s, unequal.values, self._cause(unequal))

    def _cause(self, unequal: Unequal) -> str:
        """What most likely made them differ."""
        if self.recorded.unlike:
            fields = ", ".join(self.recorded.unlike[:4])
            return f"another version of the program recorded it: its records are not those of this one ({fields})"
        if self.outcome.is_other_version:
            return "another version of the program recorded it: the sources of its cycle are not those of this one"
        first = unequal.values[0].name
        if not self.recorded.is_complete and first not in ("reference_um", "estimate_um", "setpoint_um"):
            return f"an older version recorded it, and its rows do not say: {', '.join(self.recorded.lacks)}"
        if not self.outcome.sources:
            return "the file does not say which version of the program recorded it; it may have been another one"
        if first in ("state", "phase", "fault"):
            return "something led to another state that the rows do not say"
        return (
            "the same sources compute something else here: a row was changed, or another processor or mathematical "
            "library rounds differently"
        )
