"""The 10 kHz loop: absolute deadlines around the cell's cycle, and its traffic with the host.

Each period: wait for the deadline, exchange with the hardware, take over parameters and commands,
run the cell (``cell.py``, ``axis.py``), publish a telemetry row. After an overrun the missed cycles are
counted and skipped, never made up in a burst: the deadline moves on along its grid, and the laws are
told how many periods really passed. A driver with a clock may move that grid, by a hundredth of a period a cycle.
"""

from __future__ import annotations

from typing import Any

from numba import types

from . import mailbox
from .bumpless import swap_cell
from .clock import now_ns, wait_until
from .cycle import run_cycle
from .exchange import exchange_all
from .histogram import count
from .intrinsics import load_acquire, store_release
from .jit import compiled
from .shadow import shadow_cycle, start_shadow, takes_back
from .signatures import DRIVERS, OUTPUTS, PARAMETERS, ROWS, SAMPLES, SIGNALS, STATES, WORDS
from .states import NO_COMMAND, NO_SHADOW, OFF, PROMOTE
from .telemetry import write_row

STEERED_SHARE = 100
"""The next deadline is moved by this part of a period at most."""


@compiled
def publish(words: Any, s: Any) -> None:
    """Tell the host where the loop is."""
    store_release(words, mailbox.STATE, s["state"])
    store_release(words, mailbox.FAULT_CODE, s["fault"])
    store_release(words, mailbox.TRIPS, s["trips"])
    store_release(words, mailbox.OVERRUNS, s["overruns"])
    store_release(words, mailbox.SHADOW, s["shadow"])
    store_release(words, mailbox.VERSION_ACTIVE, s["version"])
    store_release(words, mailbox.CYCLE, s["cycle"])


@compiled.entry(
    types.void(
        *(WORDS, PARAMETERS, WORDS, STATES, STATES, STATES, DRIVERS, types.int64, SIGNALS, OUTPUTS, SAMPLES),
        *(WORDS, ROWS, WORDS, WORDS, WORDS, types.int64, WORDS),
    )
)
def run_loop(
    control: Any,
    parameters: Any,
    status: Any,
    states: Any,
    shadows: Any,
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
    steering_ns: Any,
) -> None:
    """Run until the state is OFF; `states`, `shadows` and `snapshots` have one element, `parameters` one a slot.

    `steering_ns` has one, by which the next deadline is to come later: a driver's, written in ``exchange``, or 0.
    """
    s = states[0]
    p = parameters[load_acquire(control, mailbox.SLOT)]
    before, candidate, shadow = p, p, shadows[0]
    candidate_number = 0
    taken = s["version"] = p["version"]
    compute_ns = 0
    deadline = now_ns(timespec) + 10 * p["period_ns"]
    while s["state"] != OFF:
        now = wait_until(timespec, deadline, spin_ns)
        late = now - deadline
        missed = late // p["period_ns"]
        deadline += missed * p["period_ns"]
        periods = 1 + missed

        code = exchange_all(drivers, driver_count, outputs, signals, deadline, periods)
        version = load_acquire(control, mailbox.VERSION)
        if version != taken:
            taken = version
            new = parameters[load_acquire(control, mailbox.SLOT)]
            swap_cell(p, new, s)
            s["shadow"] = NO_SHADOW
            p = new
        number = load_acquire(control, mailbox.CANDIDATE_NUMBER)
        if number != candidate_number:
            candidate_number = number
            candidate = parameters[load_acquire(control, mailbox.CANDIDATE)]
            start_shadow(p, candidate, s, shadow)
        command, number = NO_COMMAND, load_acquire(control, mailbox.COMMAND_NUMBER)
        if number != status[mailbox.COMMAND_DONE]:
            command = load_acquire(control, mailbox.COMMAND)
        silent_ns = max(0, now - load_acquire(control, mailbox.HEARTBEAT_NS))
        accepted = run_cycle(p, s, signals, outputs, samples, code, command, deadline, missed, silent_ns)
        if command == PROMOTE and accepted:
            swap_cell(p, candidate, s)
            before, p = p, candidate
        elif takes_back(p, s):
            swap_cell(p, before, s)
            p = before
        shadow_cycle(p, candidate, s, shadow, samples, deadline)

        head = ring[mailbox.RING_HEAD]
        write_row(p, s, signals, rows[head % len(rows)], deadline, late, compute_ns, periods)
        store_release(ring, mailbox.RING_HEAD, head + 1)
        publish(status, s)
        if number != status[mailbox.COMMAND_DONE]:
            store_release(status, mailbox.COMMAND_ACCEPTED, 1 if accepted else 0)
            store_release(status, mailbox.COMMAND_DONE, number)
        wanted = load_acquire(control, mailbox.SNAPSHOT_NUMBER)
        if wanted != status[mailbox.SNAPSHOT_DONE]:
            snapshots[0] = s
            store_release(status, mailbox.SNAPSHOT_DONE, wanted)
        count(lateness, late)
        status[mailbox.LATENESS_MAX_NS] = max(status[mailbox.LATENESS_MAX_NS], late)
        compute_ns = now_ns(timespec) - now
        count(compute, compute_ns)
        status[mailbox.COMPUTE_MAX_NS] = max(status[mailbox.COMPUTE_MAX_NS], compute_ns)
        status[mailbox.CYCLES_RUN] += 1
        most_ns = p["period_ns"] // STEERED_SHARE
        deadline += p["period_ns"] + min(max(steering_ns[0], -most_ns), most_ns)
