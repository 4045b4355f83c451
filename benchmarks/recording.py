"""Recorded signals of the simulated cell, and the two ways to run the cycle on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from micromanip.rt.cell import cell_cycle
from micromanip.rt.jit import Compiler
from micromanip.rt.records import CELL_STATE, MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.signatures import OUTPUTS, PARAMETERS, ROWS, SAMPLES, STATES, WORDS
from micromanip.rt.states import NO_COMMAND
from micromanip.rt.telemetry import ROW, write_row
from micromanip.rt.transitions import begin_cycle
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment

from .twin import compile_twin

_compiled = Compiler(__file__)
_SIGNAL_LOG = types.Array(numba.from_dtype(SIGNAL), 2, "C")


@dataclass(frozen=True)
class Recording:
    """A stretch of cycles: the state before it, and what came in during it."""

    parameters: NDArray[Any]
    state: NDArray[Any]
    signals: NDArray[Any]
    """(cycles, MAX_SIGNALS)"""
    periods: NDArray[np.int64]
    samples: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, MAX_AXES)))
    """Own references and learned corrections, (rows, MAX_AXES)."""


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


@_compiled.entry(types.void(PARAMETERS, STATES, STATES, _SIGNAL_LOG, WORDS, OUTPUTS, SAMPLES, ROWS, types.int64))
def replay(
    parameters: Any,
    first: Any,
    state: Any,
    signals: Any,
    periods: Any,
    outputs: Any,
    samples: Any,
    rows: Any,
    repeats: int,
) -> None:
    """Run all cycles of the log `signals` (cycles, MAX_SIGNALS), `repeats` times from the state `first`; a row each."""
    p, s = parameters[0], state[0]
    for _ in range(repeats):
        state[0] = first[0]
        for k in range(len(signals)):
            now_ns = (s["cycle"] + periods[k]) * p["period_ns"]
            begin_cycle(s, periods[k] - 1)
            cell_cycle(p, s, signals[k], outputs, samples, NO_COMMAND, now_ns)
            write_row(p, s, signals[k], rows[k], now_ns, 0, 0, periods[k])


def record_tracking(prepared: Prepared, seconds: float, cycles: int) -> Recording:
    """`cycles` of the virtual cell, `seconds` after tracking began."""
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm()
    cell.run(seconds, every=1000)
    period_s = prepared.configuration.loop.period_ns * 1e-9
    state, log = cell.state.copy(), np.zeros((cycles, MAX_SIGNALS), SIGNAL)
    for k in range(cycles):
        cell.run(period_s)
        log[k] = cell.signals
    return Recording(cell.parameters, state, log, np.ones(cycles, np.int64))


def ours(recording: Recording, outcome: Outcome, repeats: int) -> None:
    """Replay with the controller's own compiled cycle."""
    replay(
        recording.parameters,
        recording.state,
        outcome.state,
        recording.signals,
        recording.periods,
        outcome.outputs,
        recording.samples,
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
            recording.periods.ctypes.data,
            outcome.outputs.ctypes.data,
            outcome.rows.ctypes.data,
            len(recording.signals),
            repeats,
        )

    return play
