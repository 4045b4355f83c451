"""Who else is pinned to the CPU of the loop: two loops on one CPU take it from each other."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

_LOOP = "micromanip.host.loop_process"
_REAL_TIME = {os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}


def cpu_conflicts(cpu: int | None, own: int) -> Iterator[str]:
    """Processes but for `own` that may run on `cpu` alone and are loops, or have a real-time priority, in words.

    Threads of the kernel, which have no command line, are on each CPU, and none of them is meant.
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
