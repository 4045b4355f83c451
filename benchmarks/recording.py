"""Recorded signals of the simulated cell, and our own cycle run on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from micromanip.rt.cell import cell_cycle
from micromanip.rt.intrinsics import now_ns
from micromanip.rt.jit import Compiler
from micromanip.rt.records import CELL_STATE, MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.signatures import OUTPUTS, PARAMETERS, ROWS, SAMPLES, STATES, WORDS
from micromanip.rt.states import NO_COMMAND
from micromanip.rt.telemetry import ROW, write_row
from micromanip.rt.transitions import begin_cycle
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment

_compiled = Compiler(__file__)
LINE_WORDS = 8
"""int64 words of a cache line; ``twin.c`` has the same."""
_SIGNAL_LOG = types.Array(numba.from_dtype(SIGNAL), 2, "C")


@dataclass(frozen=True)
class Recording:
    """A stretch of cycles: the state before it, and what came in during it."""

    parameters: NDArray[Any]
    state: NDArray[Any]
    signals: NDArray[Any]
    """(cycles, MAX_SIGNALS)"""
    samples: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, MAX_AXES)))
    """Own references and learned corrections, (rows, MAX_AXES)."""
    swept: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """What a neighbour on the core works on before each cycle; nothing: there is none, and no cycle is timed."""


@dataclass(frozen=True)
class Outcome:
    """What a replay leaves behind."""

    state: NDArray[Any]
    outputs: NDArray[np.float64]
    rows: NDArray[Any]
    taken_ns: NDArray[np.int64]
    """Time of each cycle, where a neighbour works."""

    @classmethod
    def room(cls, cycles: int) -> Outcome:
        """Memory for the outcome of so many cycles."""
        return cls(np.zeros(1, CELL_STATE), np.zeros(MAX_OUTPUTS), np.zeros(cycles, ROW), np.zeros(cycles, np.int64))


Player = Callable[[Recording, Outcome, int], None]
"""Replays a recording so many times into an outcome."""


@_compiled.entry(
    types.void(*(PARAMETERS, STATES, STATES, _SIGNAL_LOG, OUTPUTS, SAMPLES, ROWS, types.int64), *(WORDS,) * 3)
)
def replay(
    parameters: Any,
    first: Any,
    state: Any,
    signals: Any,
    outputs: Any,
    samples: Any,
    rows: Any,
    repeats: int,
    swept: Any,
    taken_ns: Any,
    timespec: Any,
) -> None:
    """Run all cycles of the log `signals` (cycles, MAX_SIGNALS), `repeats` times from the state `first`; a row each.

    Where `swept` is not empty a word of each of its cache lines is written before each cycle, and `taken_ns` filled.
    """
    p, s = parameters[0], state[0]
    for _ in range(repeats):
        state[0] = first[0]
        for k in range(len(signals)):
            for j in range(0, len(swept), LINE_WORDS):
                swept[j] += 1
            begun_ns = now_ns(timespec) if len(swept) > 0 else 0
            deadline_ns = (s["cycle"] + 1) * p["period_ns"]
            begin_cycle(s, 0)
            cell_cycle(p, s, signals[k], outputs, samples, NO_COMMAND, deadline_ns)
            write_row(p, s, signals[k], rows[k], deadline_ns, 0, 0, 1)
            if len(swept) > 0:
                taken_ns[k] = now_ns(timespec) - begun_ns


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
    return Recording(cell.parameters, state, log)


def ours(recording: Recording, outcome: Outcome, repeats: int) -> None:
    """Replay with the controller's own compiled cycle."""
    replay(
        recording.parameters,
        recording.state,
        outcome.state,
        recording.signals,
        outcome.outputs,
        recording.samples,
        outcome.rows,
        repeats,
        recording.swept,
        outcome.taken_ns,
        np.zeros(2, np.int64),
    )
