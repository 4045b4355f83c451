"""What a process asks of the kernel in order to come to its turn in time."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
from collections.abc import Iterator
from pathlib import Path

_MCL_CURRENT_AND_FUTURE, _MCL_ONFAULT = 3, 4
_CAP_IPC_LOCK = 14
_AUTOGROUP = Path("/proc/self/autogroup")


def lock_memory(*, once_touched: bool = False) -> bool:
    """Keep all memory of the calling process, now and later, from being paged out; False where it may not.

    Code counts too: what was not needed for a while is dropped, and read from the disk again when it is.
    `once_touched` is for processes that go on to allocate: it leaves out what was never used; where there is a limit
    it locks nothing, since the allocation that one day reaches it would fail.
    """
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if once_touched and not (unlimited or _has_capability(_CAP_IPC_LOCK)):
        return False
    flags = _MCL_CURRENT_AND_FUTURE | (_MCL_ONFAULT if once_touched else 0)
    return bool(ctypes.CDLL(None).mlockall(flags) == 0)


def leave_cpu(cpu: int | None) -> None:
    """Keep the calling process off the loop's CPU, where there is another one."""
    others = os.sched_getaffinity(0) - {cpu}
    if cpu is not None and others:
        os.sched_setaffinity(0, others)


def stay_on_cpu(cpu: int) -> bool:
    """Pin the calling process to a CPU; False where there is no such one, or it is not allowed."""
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError:
        return False
    return True


def put_on_cpu(pid: int, cpu: int | None) -> None:
    """Let another process go on on that CPU, if it may, and before ordinary work as the caller does.

    One that was started before the caller knew of a CPU, or asked for its nice value, has not inherited them.
    """
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, 0))
    if cpu is not None:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(pid, {cpu})


def go_before_ordinary_work(nice: int) -> bool:
    """An ordinary process still, but one with the nice value `nice`; False where that is not permitted."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, nice)
    except PermissionError:
        return False
    _set_session_nice(nice)
    return True


def _session_nice() -> int | None:
    """Nice value of the whole session, where the kernel shares the CPUs out by session: ``/autogroup-7 nice 0``."""
    try:
        return int(_AUTOGROUP.read_text(encoding="ascii").split()[-1])
    except (OSError, ValueError, IndexError):
        return None


def _set_session_nice(nice: int) -> None:
    """There a nice value counts only among the processes of one session."""
    with contextlib.suppress(OSError):
        _AUTOGROUP.write_text(str(nice), encoding="ascii")


@contextlib.contextmanager
def precedence_restored() -> Iterator[None]:
    """Takes back what is asked for meanwhile: nice values, CPUs and locked memory are as before.

    For a process that is the host of a loop for a while and then goes on with work that is in no hurry.
    """
    nice, cpus, of_session = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getaffinity(0), _session_nice()
    try:
        yield
    finally:
        ctypes.CDLL(None).munlockall()
        os.sched_setaffinity(0, cpus)
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, nice)
        if of_session is not None:  # the terminal's, and another value: whoever types `nice` means one process
            _set_session_nice(of_session)


def _has_capability(number: int) -> bool:
    """Whether it is in force for this process (capabilities(7))."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    in_force = next(line.split()[1] for line in status.splitlines() if line.startswith("CapEff:"))
    return bool(int(in_force, 16) >> number & 1)
