"""CLOCK_MONOTONIC for compiled code: now, and sleep-then-spin until an absolute deadline."""

from __future__ import annotations

import time
from typing import Any

import numba
from numba import types

from .jit import compiled

_MONOTONIC, _ABSOLUTE = 1, 1
_SECOND_NS = 1_000_000_000

if numba.config.DISABLE_JIT:

    def now_ns(timespec: Any) -> int:
        """Nanoseconds of CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def sleep_until(timespec: Any, wake_ns: int) -> None:
        """Sleep to the absolute time `wake_ns`."""
        time.sleep(max(0, wake_ns - time.monotonic_ns()) * 1e-9)

else:
    _clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
    _clock_nanosleep = types.ExternalFunction(
        "clock_nanosleep", types.int32(types.int32, types.int32, types.intp, types.intp)
    )

    @compiled
    def now_ns(timespec: Any) -> int:
        """Nanoseconds of CLOCK_MONOTONIC; `timespec` is scratch, int64 (2,)."""
        _clock_gettime(_MONOTONIC, timespec.ctypes.data)
        return timespec[0] * _SECOND_NS + timespec[1]

    @compiled
    def sleep_until(timespec: Any, wake_ns: int) -> None:
        """Sleep to the absolute time `wake_ns`; returns early only at a signal."""
        timespec[0] = wake_ns // _SECOND_NS
        timespec[1] = wake_ns % _SECOND_NS
        _clock_nanosleep(_MONOTONIC, _ABSOLUTE, timespec.ctypes.data, 0)


@compiled
def wait_until(timespec: Any, deadline_ns: int, spin_ns: int) -> int:
    """Sleep to `spin_ns` before `deadline_ns`, spin the rest; returns the time it then is.

    The kernel's wake-up is tens of microseconds late; the spin absorbs that, at the price of a CPU
    that is busy for that share of the period.
    """
    now = now_ns(timespec)
    if deadline_ns - now > spin_ns:
        sleep_until(timespec, deadline_ns - spin_ns)
        now = now_ns(timespec)
    while now < deadline_ns:
        now = now_ns(timespec)
    return now
