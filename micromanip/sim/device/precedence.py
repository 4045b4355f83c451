"""Where and how urgently a process runs that plays devices: a real device has a processor of its own."""

from __future__ import annotations

from micromanip.io.rights import go_before_ordinary_work, leave_cpu, lock_memory

_NICE = -10


def take_precedence(loop_cpu: int | None) -> None:
    """Off the control loop's CPU, and before ordinary work where that is permitted.

    Stays an ordinary process all the same: what has real-time priority on this machine is the controller.
    """
    leave_cpu(loop_cpu)
    lock_memory(once_touched=True)
    go_before_ordinary_work(_NICE)
