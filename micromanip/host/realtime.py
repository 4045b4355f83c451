"""Real-time set-up of the loop process: memory locked, pinned, FIFO, CPU awake; what it lacks, who else is there."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from micromanip.bus.rights import lock_memory, stay_on_cpu
from micromanip.rt.mailbox import NO_FIFO, NO_LOCK, NO_PIN

_LATENCY_WANTED = "/dev/cpu_dma_latency"
_LOOP = "micromanip.host.loop_process"
_REAL_TIME = {os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}

ADVICE = {
    NO_FIFO: "no SCHED_FIFO: other processes delay the loop; allow it with LimitRTPRIO= in the unit, or rtprio in "
    "/etc/security/limits.d",
    NO_LOCK: "memory not locked: page faults delay the loop; allow it with LimitMEMLOCK=infinity in the unit, or "
    "memlock in /etc/security/limits.d",
    NO_PIN: "not pinned to the configured CPU: it does not exist or is not allowed here",
}
NO_NICE = (
    "the host process does not go before ordinary work: other processes delay its sign of life; allow it with "
    "LimitNICE=-10 in the unit, or nice in /etc/security/limits.d"
)


def enter_real_time(cpu: int | None, priority: int) -> int:
    """Set the calling process up for the loop; returns the bits of what was refused.

    Called last, after everything is compiled, allocated and touched.
    """
    refused = 0
    if not lock_memory():
        refused |= NO_LOCK
    if cpu is not None and not stay_on_cpu(cpu):
        refused |= NO_PIN
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        refused |= NO_FIFO
    _stay_awake()
    return refused


def _stay_awake() -> None:
    """Keep the CPUs out of sleep states that take time to leave, as long as this process lives; where that is allowed.

    The kernel takes the request back when the descriptor is closed, so it stays open.
    """
    with contextlib.suppress(OSError):
        os.write(os.open(_LATENCY_WANTED, os.O_WRONLY | os.O_CLOEXEC), (0).to_bytes(4, "little"))


def missing_rights(bits: int) -> list[str]:
    """One line of advice for each right in `bits`."""
    return [advice for bit, advice in ADVICE.items() if bits & bit]


def cpu_conflicts(cpu: int | None, own: int) -> Iterator[str]:
    """Processes but for `own` that may run on `cpu` alone and are loops, or have a real-time priority, in words.

    Two loops on one CPU take it from each other. Threads of the kernel, which have no command line, are on each CPU,
    and none of them is meant.
    """
    for entry in Path("/proc").iterdir() if cpu is not None else ():
        if not entry.name.isdigit() or int(entry.name) == own:
            continue
        with contextlib.suppress(OSError, ValueError):  # it has ended meanwhile
            pid = int(entry.name)
            if os.sched_getaffinity(pid) != {cpu} or not (command := _command(pid)):
                continue
            policy = os.sched_getscheduler(pid)
            if _LOOP in command:
                yield f"the loop of another cell, process {pid}, is pinned to it, too: `{_command(_parent(pid))}`"
            elif policy in _REAL_TIME:
                priority = os.sched_getparam(pid).sched_priority
                yield f"process {pid} is pinned to it with {_REAL_TIME[policy]} {priority}: `{command}`"


def _command(pid: int) -> str:
    """Its command line, as it was typed."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()[:200]


def _parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
