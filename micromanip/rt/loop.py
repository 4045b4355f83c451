"""The 10 kHz loop: absolute deadlines around the cell's cycle, and its traffic with the host.

Each period: wait for the deadline, exchange with the hardware, take over parameters and commands, run the cell
(``cell.py``, ``axis.py``), publish a telemetry row. After an overrun the missed cycles are counted and skipped, never
made up in a burst: the deadline stays on its grid, and the laws get the number of periods that passed. A driver with a
clock may move that grid, by a hundredth of a period a cycle.
"""

from __future__ import annotations

from typing import Any

from numba import types

from . import mailbox
from .cycle import exchange_all, run_cycle
from .intrinsics import load_acquire, now_ns, store_release, wait_until
from .jit import compiled
from .mailbox import CONTROL, RING, STATUS, count
from .shadow import shadow_cycle, start_shadow, swap_cell, takes_back
from .signatures import DRIVERS, SAMPLES, WORDS, array_of
from .states import NO_COMMAND, NO_SHADOW, OFF, PROMOTE
from .telemetry import write_row

STEERED_SHARE = 100
"""The next deadline is moved by this part of a period at most."""


@compiled
def publish(words: Any, s: Any) -> None:
    """Publish the loop's words for the host."""
    store_release(words, mailbox.STATE, s["state"])
    store_release(words, mailbox.FAULT_CODE, s["fault"])
    store_release(words, mailbox.TRIPS, s["trips"])
    store_release(words, mailbox.OVERRUNS, s["overruns"])
    store_release(words, mailbox.SHADOW, s["shadow"])
    store_release(words, mailbox.VERSION_ACTIVE, s["version"])
    store_release(words, mailbox.CYCLE, s["cycle"])


@compiled.entry(types.void(array_of(CONTROL), array_of(STATUS), array_of(RING), DRIVERS, SAMPLES, types.int64, WORDS))
def run_loop(
    control_segment: Any, status_segment: Any, ring: Any, drivers: Any, samples: Any, spin_ns: int, steering_ns: Any
) -> None:
    """Run until the state is OFF, on the segments of shared memory, each an array of one record (``mailbox.py``).

    `steering_ns` has one, by which the next deadline is to come later: a driver's, written in ``exchange``, or 0.
    """
    control, parameters = control_segment[0]["words"], control_segment[0]["parameters"]
    own, rows, heads = status_segment[0], ring[0]["rows"], ring[0]["words"]
    status, signals, outputs, timespec = own["words"], own["signals"], own["outputs"], own["timespec"]
    s, shadow = own["state"][0], own["shadow"][0]
    p = parameters[load_acquire(control, mailbox.SLOT)]
    before, candidate = p, p
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

        code = exchange_all(drivers, outputs, signals, deadline, periods)
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

        head = heads[mailbox.RING_HEAD]
        write_row(p, s, signals, rows[head % len(rows)], deadline, late, compute_ns, periods)
        store_release(heads, mailbox.RING_HEAD, head + 1)
        publish(status, s)
        if number != status[mailbox.COMMAND_DONE]:
            store_release(status, mailbox.COMMAND_ACCEPTED, 1 if accepted else 0)
            store_release(status, mailbox.COMMAND_DONE, number)
        wanted = load_acquire(control, mailbox.SNAPSHOT_NUMBER)
        if wanted != status[mailbox.SNAPSHOT_DONE]:
            own["snapshot"][0] = s
            store_release(status, mailbox.SNAPSHOT_DONE, wanted)
        count(own["lateness"], late)
        status[mailbox.LATENESS_MAX_NS] = max(status[mailbox.LATENESS_MAX_NS], late)
        compute_ns = now_ns(timespec) - now
        count(own["compute"], compute_ns)
        status[mailbox.COMPUTE_MAX_NS] = max(status[mailbox.COMPUTE_MAX_NS], compute_ns)
        status[mailbox.CYCLES_RUN] += 1
        most_ns = p["period_ns"] // STEERED_SHARE
        deadline += p["period_ns"] + min(max(steering_ns[0], -most_ns), most_ns)
