"""How long a CPU is away from a process that does nothing but watch the clock, at the loop's priority.

What it misses there is no scheduler's doing: interrupts, the hypervisor, the firmware. Run as a process of its own,
``python -m micromanip.host.readiness.clock_gaps CPU PRIORITY SECONDS``, which prints its gaps as JSON.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time

from micromanip.bus.rights import lock_memory, stay_on_cpu

_BURST_S, _REST_S = 0.5, 0.1
"""Less than the 95 % of a second after which the kernel would stop it."""
_COUNTED_NS = 2_000
"""Shorter gaps are those between two readings of the clock."""


def watch(end_ns: int) -> list[int]:
    """Watch CLOCK_MONOTONIC to `end_ns`; the gaps (ns) between two readings that were longer than 2 us."""
    gaps, clock = [], time.monotonic_ns
    before = clock()
    while before < end_ns:
        now = clock()
        if now - before > _COUNTED_NS:
            gaps.append(now - before)
        before = now
    return gaps


def main(cpu: int, priority: int, seconds: float) -> None:
    """Print the longest gap and the 99th percentile (ns), how many there were a second, and their share of the time."""
    lock_memory()
    if not stay_on_cpu(cpu):
        sys.exit(f"CPU {cpu} is not allowed here")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        sys.exit("SCHED_FIFO is refused here")
    gc.disable()
    gaps: list[int] = []
    bursts = max(1, round(seconds / (_BURST_S + _REST_S)))
    for _ in range(bursts):
        gaps += watch(time.monotonic_ns() + round(_BURST_S * 1e9))
        time.sleep(_REST_S)
    gaps.sort()
    found = {
        "max_ns": gaps[-1] if gaps else 0,
        "p99_ns": gaps[int(0.99 * len(gaps))] if gaps else 0,
        "per_s": round(len(gaps) / (bursts * _BURST_S), 1),
        "share": round(sum(gaps) / (bursts * _BURST_S * 1e9), 6),
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
