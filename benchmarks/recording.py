"""Recorded signals of the simulated cell, and the two ways to run the cycle on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt import arming
from micromanip.rt.records import CELL_STATE, MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.states import ARM, NO_COMMAND
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import Prepared
from micromanip.virtual.cell import VirtualCell
from micromanip.virtual.experiment import VirtualExperiment

from .replay import replay
from .twin import compile_twin, require_covered

_SETTLE_CYCLES = 100


@dataclass(frozen=True)
class Recording:
    """A stretch of cycles: the state before it, and what came in during it."""

    parameters: NDArray[Any]
    state: NDArray[Any]
    signals: NDArray[Any]
    """(cycles, MAX_SIGNALS)"""
    commands: NDArray[np.int64]
    periods: NDArray[np.int64]


@dataclass(frozen=True)
class Outcome:
    """What a replay leaves behind."""

    state: NDArray[Any]
    outputs: NDArray[np.float64]
    rows: NDArray[Any]

    @classmethod
    def room(cls, cycles: int) -> Outcome:
        """Memory for the outcome of so many cycles."""
        return cls(np.zeros(1, CELL_STATE), np.zeros(MAX_OUTPUTS), np.zeros(cycles, ROW))


Player = Callable[[Recording, Outcome, int], None]
"""Replays a recording so many times into an outcome."""


def arming_cycles(prepared: Prepared) -> int:
    """Cycles from the start of `record_arming` to TRACKING."""
    return _SETTLE_CYCLES + int(arming.planned_cycles(prepared.parameters[0], np.zeros(1, CELL_STATE)[0]))


def record_arming(prepared: Prepared, tracking: int) -> Recording:
    """The virtual cell from its first cycle: sensors come up, arming, and `tracking` cycles of TRACKING."""
    return _record(prepared, _cell(prepared), arming_cycles(prepared) + tracking, _SETTLE_CYCLES)


def record_tracking(prepared: Prepared, seconds: float, cycles: int) -> Recording:
    """`cycles` of the virtual cell, `seconds` after tracking began."""
    cell = _cell(prepared)
    cell.arm()
    cell.run(seconds, every=1000)
    return _record(prepared, cell, cycles, None)


def _cell(prepared: Prepared) -> VirtualCell:
    return VirtualExperiment(prepared, process=True).cell(prepared.configuration)


def _record(prepared: Prepared, cell: VirtualCell, cycles: int, arm_at: int | None) -> Recording:
    require_covered(prepared.parameters)
    period_s = prepared.configuration.loop.period_ns * 1e-9
    state, log = cell.state.copy(), np.zeros((cycles, MAX_SIGNALS), SIGNAL)
    commands = np.full(cycles, NO_COMMAND, np.int64)
    if arm_at is not None:
        commands[arm_at] = ARM
    for k in range(cycles):
        cell.run(period_s, command=int(commands[k]))
        log[k] = cell.signals
    return Recording(cell.parameters, state, log, commands, np.ones(cycles, np.int64))


def ours(recording: Recording, outcome: Outcome, repeats: int) -> None:
    """Replay with the controller's own compiled cycle."""
    samples = np.zeros((1, MAX_AXES))
    replay(
        recording.parameters,
        recording.state,
        outcome.state,
        recording.signals,
        recording.commands,
        recording.periods,
        outcome.outputs,
        samples,
        outcome.rows,
        repeats,
    )


def twin_player(folder: Path) -> Player:
    """Replay with the C twin, built in `folder`; raises Skipped where there is no gcc."""
    function = compile_twin(folder)

    def play(recording: Recording, outcome: Outcome, repeats: int) -> None:
        function(
            recording.parameters.ctypes.data,
            recording.state.ctypes.data,
            outcome.state.ctypes.data,
            recording.signals.ctypes.data,
            recording.commands.ctypes.data,
            recording.periods.ctypes.data,
            outcome.outputs.ctypes.data,
            outcome.rows.ctypes.data,
            len(recording.signals),
            repeats,
        )

    return play
