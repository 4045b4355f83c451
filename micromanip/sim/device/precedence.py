"""Where and how urgently a process runs that plays devices: a real device has a processor of its own."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from micromanip.io.rights import leave_cpu, lock_memory

_NICE = -10
_AUTOGROUP = Path("/proc/self/autogroup")


def take_precedence(loop_cpu: int | None) -> None:
    """Off the control loop's CPU, and before ordinary work where that is permitted.

    Stays an ordinary process all the same: what has real-time priority on this machine is the controller.
    """
    leave_cpu(loop_cpu)
    lock_memory(once_touched=True)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    # Where the kernel shares the CPUs out by session, a nice value counts only among the processes of one session.
    with contextlib.suppress(OSError):
        _AUTOGROUP.write_text(str(_NICE))
