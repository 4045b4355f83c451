"""Where and how urgently a process runs that emulates devices: a real device has a processor of its own."""

from __future__ import annotations

import os

from micromanip.bus.rights import go_before_ordinary_work, leave_cpu, lock_memory

_PRIORITY = 1
_NICE = -10


def take_precedence(loop_cpu: int | None) -> None:
    """Off the control loop's CPU, and before ordinary work where that is permitted.

    At the least of the real-time priorities: after the loop and its bus workers, before their host and all that
    records or prints. As an ordinary process it would wait some ms for each of those, and its samples with it; an
    event loop that never comes to rest leaves the others some time all the same (``EventLoop``).
    """
    leave_cpu(loop_cpu)
    lock_memory(once_touched=True)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except PermissionError:
        go_before_ordinary_work(_NICE)
