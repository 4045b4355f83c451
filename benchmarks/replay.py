"""Our side of the cycle benchmark: the compiled cycle on recorded signals, without hardware and without a clock."""

from __future__ import annotations

from typing import Any

import numba
from numba import types

from micromanip.rt.cell import cell_cycle
from micromanip.rt.jit import Compiler
from micromanip.rt.records import SIGNAL
from micromanip.rt.signatures import OUTPUTS, PARAMETERS, ROWS, SAMPLES, STATES, WORDS
from micromanip.rt.states import NO_COMMAND
from micromanip.rt.telemetry import write_row
from micromanip.rt.transitions import begin_cycle

_compiled = Compiler(__file__)
_SIGNAL_LOG = types.Array(numba.from_dtype(SIGNAL), 2, "C")


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
