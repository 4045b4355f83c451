"""One cycle of everything: the same in the loop, in virtual time and in a replay.

    exchange | begin: count the cycle | watch: deadlines, host, drivers, devices | control: ``cell.py``
    | report: ``telemetry.py``

The loop takes its orders (parameters, candidates, commands) between exchange and begin. In virtual time there is no
deadline and no host: as fast as it computes, the same numbers every time.
"""

from __future__ import annotations

from typing import Any

from numba import types

from micromanip.rt.laws.coordinate_transform import derive_signals

from . import states
from .axis_order import see_behind
from .bus_image import AWAY, TAKEN
from .cell import cell_cycle
from .digital_io import is_enabled
from .faults import cell_fault
from .intrinsics import call_exchange
from .jit import compiled
from .record import Record
from .records import MAX_DRIVERS, SIGNAL
from .signatures import DRIVERS, OUTPUTS, PARAMETERS, ROWS, SAMPLES, SIGNALS, STATES
from .telemetry import write_row
from .transitions import begin_cycle

NO_HOST = -1
"""In place of a host's silence: virtual time has neither a host nor deadlines."""
_SIGNAL_BYTES = SIGNAL.itemsize
_OUTPUT_BYTES = 8
FIRST_TAKEN = -1 - MAX_DRIVERS
"""What ``exchange_all`` returns where the first driver's outputs do not follow the loop; one less for the second."""
ALL_FOLLOW = FIRST_TAKEN - MAX_DRIVERS
"""What it returns where all outputs follow the loop, and those of a bus are not known to be at rest."""


@compiled
def exchange_all(drivers: Any, outputs: Any, signals: Any, now_ns: int, periods: int) -> int:
    """Write `outputs`, read `signals` through every driver.

    0; else the code of the first that failed; else, where a link is down, -1 less the number of that driver; else,
    where outputs do not follow the loop, `FIRST_TAKEN` less the number of that driver; else, where a device is not
    known to be at rest, `ALL_FOLLOW`.
    """
    failed, down, taken, away = 0, 0, 0, 0
    for i in range(len(drivers)):
        code = call_exchange(
            drivers[i]["exchange"],
            drivers[i]["context"],
            outputs.ctypes.data + drivers[i]["first_output"] * _OUTPUT_BYTES,
            signals.ctypes.data + drivers[i]["first_input"] * _SIGNAL_BYTES,
            now_ns,
            periods,
        )
        if code > 0 and failed == 0:
            failed = code
        elif code == TAKEN and taken == 0:
            taken = FIRST_TAKEN - i
        elif code == AWAY:
            away = ALL_FOLLOW
        elif code < 0 and code != TAKEN and down == 0:
            down = -1 - i
    if failed != 0:
        return failed
    if down != 0:
        return down
    return taken if taken != 0 else away


@compiled
def run_cycle(
    p: Record,
    s: Record,
    signals: Any,
    outputs: Any,
    samples: Any,
    code: int,
    command: int,
    now_ns: int,
    missed: int,
    silent_ns: int,
) -> bool:
    """The cycle at `now_ns` behind an exchange that returned `code`; False where `command` was refused.

    `missed` cycles before it never ran; `silent_ns` is the host's silence, or `NO_HOST`.
    """
    begin_cycle(s, missed)
    if silent_ns != NO_HOST:
        watch_loop(p, s, silent_ns, missed)
    watch_drivers(p, s, code)
    see_behind(p, s, outputs)
    derive_signals(p, s, signals)
    return cell_cycle(p, s, signals, outputs, samples, command, now_ns)


@compiled
def watch_loop(p: Record, s: Record, silent_ns: int, missed: int) -> None:
    """Watch the deadlines and the host: without one the loop brings its outputs to park and ends.

    Missed cycles are counted first: a ramp that begins now begins at its start. Missed deadlines fill a leaky bucket,
    which leaks by the allowed share.
    """
    s["overruns"] += missed
    s["overruns_in_a_row"] = s["overruns_in_a_row"] + missed if missed > 0 else 0
    s["overrun_level"] = max(0.0, s["overrun_level"] + missed - p["overrun_share"] * (1 + missed))
    many = s["overruns_in_a_row"] >= p["overruns_in_a_row"]
    often = s["overrun_level"] > p["overrun_level"]
    limit = float(p["overruns_in_a_row"]) if many else p["overrun_level"]
    cell_fault(
        p, s, states.OVERRUNS, many or often, float(s["overruns_in_a_row"]) if many else s["overrun_level"], limit
    )
    dead = silent_ns > p["heartbeat_ns"]
    cell_fault(p, s, states.HOST_DEAD, dead, silent_ns * 1e-6, p["heartbeat_ns"] * 1e-6)
    if dead:
        s["stopping"] = 1


@compiled
def watch_drivers(p: Record, s: Record, code: int) -> None:
    """Judge what the exchange of this cycle returned.

    A failure is a fault in any state; a link that is down only in use. Outputs that do not follow the loop are a fault
    while the loop moves the axes: not at park, and not on a ramp to park.
    """
    taken = ALL_FOLLOW < code <= FIRST_TAKEN
    s["link_down"] = 1 if FIRST_TAKEN < code < 0 else 0
    s["outputs_taken"] = 1 if taken else 0
    s["outputs_away"] = 1 if code != 0 else 0
    state = s["state"]
    parks = (state == states.RAMPING and s["soft"] == 0) or (state == states.ARMING and s["phase"] == states.PARKED)
    moves = is_enabled(s) and not parks
    cell_fault(p, s, states.DRIVER_ERROR, code > 0, float(code), 0.0)
    cell_fault(p, s, states.LINK_LOST, s["link_down"] != 0 and is_enabled(s), float(-1 - code), 0.0)
    cell_fault(p, s, states.OUTPUTS_TAKEN, taken and moves, float(FIRST_TAKEN - code), 0.0)


@compiled.entry(
    types.int64(
        *(PARAMETERS, STATES, DRIVERS, SIGNALS, OUTPUTS, SAMPLES, ROWS),
        *(types.int64, types.int64, types.int64, types.int64),
    )
)
def run_virtual(
    parameters: Any,
    state: Any,
    drivers: Any,
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
        code = exchange_all(drivers, outputs, signals, now_ns, passed)
        order = command if k == 0 else states.NO_COMMAND
        run_cycle(p, s, signals, outputs, samples, code, order, now_ns, passed - 1, NO_HOST)
        if (k + 1) % every == 0 and written < len(rows):
            write_row(p, s, signals, rows[written], now_ns, 0, 0, passed)
            written += 1
    return written
