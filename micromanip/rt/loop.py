"""The 10 kHz loop: absolute deadlines around the cell's cycle, and its traffic with the host.

Each period: wait for the deadline, exchange with the hardware, take over parameters and commands,
run the cell (``cell.py``, ``axis.py``), publish a telemetry row. After an overrun the missed cycles are
counted and skipped, never made up in a burst: the deadline moves on along its grid, and the laws are
told how many periods really passed.
"""

from __future__ import annotations

from typing import Any

from numba import types

from .cell import begin_ramp, cell_cycle, enter, pass_missed, raise_fault
from .clock import now_ns, wait_until
from .exchange import exchange_all
from .histogram import count
from .intrinsics import load_acquire, store_release
from .jit import compiled
from .signatures import DRIVERS, OUTPUTS, PARAMETERS, ROWS, SAMPLES, SIGNALS, STATES, WORDS
from .states import DRIVER_ERROR, FAULT, HOST_DEAD, NO_COMMAND, NO_FAULT, OFF, OVERRUNS, READY
from .swap import swap_cell
from .telemetry import write_row
from .words import (
    COMMAND,
    COMMAND_ACCEPTED,
    COMMAND_DONE,
    COMMAND_NUMBER,
    COMPUTE_MAX_NS,
    CYCLE,
    CYCLES_RUN,
    FAULT_AXIS,
    FAULT_CODE,
    HEARTBEAT_NS,
    LATENESS_MAX_NS,
    RING_HEAD,
    SLOT,
    SNAPSHOT_DONE,
    SNAPSHOT_NUMBER,
    STATE,
    VERSION,
    VERSION_ACTIVE,
)
from .words import OVERRUNS as OVERRUNS_WORD


@compiled
def supervise(p: Any, s: Any, heartbeat_ns: int, now: int, missed: int) -> bool:
    """Watch the host and the deadlines; False once the host is gone (the loop then ramps down and ends).

    The cycles that were missed have passed before anything is decided: a ramp that begins now begins at its beginning.
    """
    pass_missed(s, missed)
    s["overruns"] += missed
    s["overruns_in_a_row"] = s["overruns_in_a_row"] + missed if missed > 0 else 0
    if s["overruns_in_a_row"] >= p["overruns_in_a_row"] and s["state"] != FAULT and s["fault"] == NO_FAULT:
        raise_fault(p, s, OVERRUNS, -1, float(s["overruns_in_a_row"]))
    if now - heartbeat_ns <= p["heartbeat_ns"]:
        return True
    if s["fault"] == NO_FAULT:
        s["fault"], s["fault_axis"] = HOST_DEAD, -1
        s["fault_value"] = (now - heartbeat_ns) * 1e-6
    if s["state"] == READY or s["state"] == FAULT:
        enter(s, OFF)
    elif s["state"] != OFF:
        begin_ramp(p, s, OFF)
    return False


@compiled
def publish(words: Any, s: Any) -> None:
    """Tell the host where the loop is."""
    store_release(words, STATE, s["state"])
    store_release(words, FAULT_AXIS, s["fault_axis"])
    store_release(words, FAULT_CODE, s["fault"])
    store_release(words, OVERRUNS_WORD, s["overruns"])
    store_release(words, CYCLE, s["cycle"])


@compiled.entry(
    types.void(
        *(WORDS, PARAMETERS, WORDS, STATES, STATES, DRIVERS, types.int64, SIGNALS, OUTPUTS, SAMPLES, WORDS, ROWS),
        *(WORDS, WORDS, WORDS, types.int64),
    )
)
def run_loop(
    control: Any,
    parameters: Any,
    status: Any,
    states: Any,
    snapshots: Any,
    drivers: Any,
    driver_count: int,
    signals: Any,
    outputs: Any,
    samples: Any,
    ring: Any,
    rows: Any,
    lateness: Any,
    compute: Any,
    timespec: Any,
    spin_ns: int,
) -> None:
    """Run until the state is OFF; `parameters` are the two slots, `states` and `snapshots` have one element."""
    s = states[0]
    p = parameters[load_acquire(control, SLOT)]
    s["version"] = p["version"]
    store_release(status, VERSION_ACTIVE, p["version"])
    compute_ns = 0
    deadline = now_ns(timespec) + 10 * p["period_ns"]
    while s["state"] != OFF:
        now = wait_until(timespec, deadline, spin_ns)
        late = now - deadline
        missed = late // p["period_ns"]
        deadline += missed * p["period_ns"]
        periods = 1 + missed

        code = exchange_all(drivers, driver_count, outputs, signals, deadline, periods)
        version = load_acquire(control, VERSION)
        if version != s["version"]:
            new = parameters[load_acquire(control, SLOT)]
            swap_cell(p, new, s)
            p = new
            store_release(status, VERSION_ACTIVE, version)
        command, number = NO_COMMAND, load_acquire(control, COMMAND_NUMBER)
        if number != status[COMMAND_DONE]:
            command = load_acquire(control, COMMAND)
        supervise(p, s, load_acquire(control, HEARTBEAT_NS), now, missed)
        if code != 0:
            raise_fault(p, s, DRIVER_ERROR, -1, float(code))
        accepted = cell_cycle(p, s, signals, outputs, samples, command, deadline, 1)

        head = ring[RING_HEAD]
        write_row(p, s, signals, rows[head % len(rows)], deadline, late, compute_ns, periods)
        store_release(ring, RING_HEAD, head + 1)
        publish(status, s)
        if number != status[COMMAND_DONE]:
            store_release(status, COMMAND_ACCEPTED, 1 if accepted else 0)
            store_release(status, COMMAND_DONE, number)
        wanted = load_acquire(control, SNAPSHOT_NUMBER)
        if wanted != status[SNAPSHOT_DONE]:
            snapshots[0] = s
            store_release(status, SNAPSHOT_DONE, wanted)
        count(lateness, late)
        status[LATENESS_MAX_NS] = max(status[LATENESS_MAX_NS], late)
        compute_ns = now_ns(timespec) - now
        count(compute, compute_ns)
        status[COMPUTE_MAX_NS] = max(status[COMPUTE_MAX_NS], compute_ns)
        status[CYCLES_RUN] += 1
        deadline += p["period_ns"]
