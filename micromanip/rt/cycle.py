"""One cycle of everything, after the exchange: the same in the loop, in virtual time and in a replay.

    exchange | begin: count the cycle | watch: deadlines, host, drivers, devices | control: ``cell.py``
    | report: ``telemetry.py``

The loop takes its orders (parameters, candidates, commands) between exchange and begin.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.laws.coordinate_transform import derive_signals

from .axis_order import see_behind
from .cell import cell_cycle, watch_drivers
from .faults import cell_fault
from .jit import compiled
from .record import Record
from .states import HOST_DEAD, OVERRUNS
from .transitions import begin_cycle

NO_HOST = -1
"""In place of a host's silence: virtual time has neither a host nor deadlines."""


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

    `missed` cycles before it never ran; for `silent_ns` the host has said nothing, or `NO_HOST`.
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

    The cycles that were missed have passed before anything is decided: a ramp that begins now begins at its beginning.
    Missed deadlines fill a bucket that leaks by the share that is allowed.
    """
    s["overruns"] += missed
    s["overruns_in_a_row"] = s["overruns_in_a_row"] + missed if missed > 0 else 0
    s["overrun_level"] = max(0.0, s["overrun_level"] + missed - p["overrun_share"] * (1 + missed))
    many = s["overruns_in_a_row"] >= p["overruns_in_a_row"]
    often = s["overrun_level"] > p["overrun_level"]
    limit = float(p["overruns_in_a_row"]) if many else p["overrun_level"]
    cell_fault(p, s, OVERRUNS, many or often, float(s["overruns_in_a_row"]) if many else s["overrun_level"], limit)
    dead = silent_ns > p["heartbeat_ns"]
    cell_fault(p, s, HOST_DEAD, dead, silent_ns * 1e-6, p["heartbeat_ns"] * 1e-6)
    if dead:
        s["stopping"] = 1
