"""The device's own time stamps in CLOCK_MONOTONIC: what the way to us adds, and how it varies, is taken out.

A datagram can be late, never early. So the smallest difference between our time of reception and the device's time is
the best guess of how far the clocks are apart, and it is too large by the shortest way only. The difference is let grow
by the rate at which two clocks may drift, so that a clock that is slower than ours is followed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.rt.jit import compiled

_DRIFT_PPM = 100
_JUMP_NS = 200_000_000
_IN_A_ROW = 5
"""So many datagrams in a row that come later than this beyond the best: the clock was set back, they are not late."""
MOST_BITS = 62
"""Of a longer stamp so many are looked at, which wrap a little earlier."""


@compiled
def forget_clock(c: Any) -> None:
    """Begin anew: another device, or the same after a power cycle."""
    c["known"] = c["ticks"] = c["late"] = 0


@compiled
def taken_ns(c: Any, stamp: Any, received_ns: int) -> int:
    """When a datagram with this stamp (uint64), which came at `received_ns`, was stamped; never after it came."""
    first = c["known"] == 0
    number = int(stamp & ((np.uint64(1) << np.uint64(c["bits"])) - np.uint64(1)))
    if not first:
        c["ticks"] += _ticks_since(c, number)
    c["stamp"], c["known"] = number, 1
    device_ns = int(c["ticks"] * c["unit_ns"])
    apart_ns = received_ns - device_ns
    late_ns = apart_ns - c["apart_ns"]
    c["late"] = c["late"] + 1 if late_ns > _JUMP_NS else 0
    if first or late_ns < -_JUMP_NS or c["late"] >= _IN_A_ROW:
        c["steps"] += 0 if first else 1
        c["apart_ns"], c["late"] = apart_ns, 0
    else:
        drift_ns = max(0, received_ns - c["received_ns"]) * _DRIFT_PPM // 1_000_000
        c["apart_ns"] = min(apart_ns, c["apart_ns"] + drift_ns)
    c["received_ns"] = received_ns
    return min(received_ns, device_ns + c["apart_ns"])


@compiled
def _ticks_since(c: Any, stamp: int) -> int:
    """Units since the stamp before; the shorter way round, where the stamp may have wrapped."""
    ahead = (stamp - c["stamp"]) % (1 << c["bits"])
    return ahead - (1 << c["bits"]) if ahead >= 1 << (c["bits"] - 1) else ahead
