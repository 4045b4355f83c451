"""The same cycle as the real loop, in virtual time: as fast as it computes, the same numbers every time."""

from __future__ import annotations

from typing import Any

from numba import types

from .cycle import NO_HOST, run_cycle
from .exchange import exchange_all
from .jit import compiled
from .signatures import DRIVERS, OUTPUTS, PARAMETERS, ROWS, SAMPLES, SIGNALS, STATES
from .states import NO_COMMAND
from .telemetry import write_row


@compiled.entry(
    types.int64(
        *(PARAMETERS, STATES, DRIVERS, types.int64, SIGNALS, OUTPUTS, SAMPLES, ROWS),
        *(types.int64, types.int64, types.int64, types.int64),
    )
)
def run_virtual(
    parameters: Any,
    state: Any,
    drivers: Any,
    driver_count: int,
    signals: Any,
    outputs: Any,
    samples: Any,
    rows: Any,
    cycles: int,
    every: int,
    command: int,
    periods: int,
) -> int:
    """Run `cycles` cycles from where `state` is, a telemetry row each `every`; returns the rows written.

    `command` is given in the first cycle, which comes `periods` after the one before: more than one is a stall of the
    machine, in which cycles were missed. Time is the cycle number times the period.
    """
    p, s = parameters[0], state[0]
    written = 0
    for k in range(cycles):
        passed = periods if k == 0 else 1
        now_ns = (s["cycle"] + passed) * p["period_ns"]
        code = exchange_all(drivers, driver_count, outputs, signals, now_ns, passed)
        order = command if k == 0 else NO_COMMAND
        run_cycle(p, s, signals, outputs, samples, code, order, now_ns, passed - 1, NO_HOST)
        if (k + 1) % every == 0 and written < len(rows):
            write_row(p, s, signals, rows[written], now_ns, 0, 0, passed)
            written += 1
    return written
