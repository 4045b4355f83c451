"""The loop's deadlines locked to a device's clock: where that clock stands, from frames there and back, and a PI law.

A frame was stamped by the device between being sent and coming back. So each frame says that

    stamp - received <= device's time - ours <= stamp - sent,

and the intersection over many frames is a narrow interval, however late most of them are; the law uses its middle. The
interval moves by the estimated drift, and widens by the possible drift. The remaining error is half of the difference
between the shortest delays there and back, which can't be measured from here; it is constant.

The deadline's error e, how late it comes on the clock's grid of periods P, grows by w = P x drift in every cycle, and
by what the law adds to the next deadline:

    u = -(K e + I),   I' = I + J e,   K = 2 (1 - r),  J = (1 - r)^2,  r = exp(-P / time constant)

Both poles lie at r, so e(k) = r^k (e(0) + k ((r - 1) e(0) + w) / r) for I(0) = 0: no residual error, and I becomes w,
by which the drift is known.

A device's stamps alone, as they come with its samples, show less: a datagram can be late, never early. So the smallest
difference between our time of reception and the device's time is the best estimate of the clocks' offset; it is too
large by the shortest delay only. The estimate grows by the rate at which two clocks may drift, to follow a clock that
is slower than ours.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.rt.jit import compiled
from micromanip.rt.record import record

from .link_gate import RECENT

DEVICE_CLOCK = record(
    ("unit_ns", "f8"),
    ("bits", "i8"),
    ("known", "i8"),
    ("stamp", "i8"),
    ("ticks", "i8"),
    ("apart_ns", "i8"),
    ("received_ns", "i8"),
    ("late", "i8"),
    ("steps", "i8"),
)
"""Of a time stamp of so many `bits`, in units of `unit_ns`, and what is known so far."""

_DRIFT_PPM = 100
_JUMP_NS = 200_000_000
_LATE_IN_A_ROW = 5
"""After so many consecutive late datagrams the clock was set back; they are not late."""
MOST_BITS = 62
"""Of a longer stamp so many are looked at, which wrap a little earlier."""

CLOCK_LOCK = record(
    ("present", "i8"),
    ("period_ns", "i8"),
    ("gain", "f8"),
    ("integral_gain", "f8"),
    ("most_ns", "f8"),
    ("drift", "f8"),
    ("within_ns", "f8"),
    ("settle_cycles", "i8"),
    ("sent_ns", "i8", (RECENT,)),
    ("known", "i8"),
    ("apart_ns", "i8"),
    ("lowest_ns", "f8"),
    ("highest_ns", "f8"),
    ("told_ns", "i8"),
    ("contradictions", "i8"),
    ("steps", "i8"),
    ("gained_ns", "f8"),
    ("rest_ns", "f8"),
    ("step_ns", "i8", (1,)),
    ("error_ns", "f8"),
    ("square_ns2", "f8"),
    ("good", "i8"),
    ("bad", "i8"),
    ("locked", "i8"),
    ("unlocked", "i8"),
)
"""Set once: the period, the law's gains, the most that a deadline moves, the most drift (a ratio), how near counts as
locked, and after how many cycles; `sent_ns` of each of the last frames. Device's time less ours lies between
``lowest_ns`` and ``highest_ns``, both on top of ``apart_ns``, as of `told_ns`. ``gained_ns`` is what the device's clock
gains in a period (I), ``step_ns`` what the next deadline comes later by; `square_ns2` is the mean square of the error
over a second. `steps` counts leaps of the clock, `unlocked` how often the lock was lost."""

_IN_A_ROW = 5
"""After so many consecutive contradicting frames the clock has jumped. A single one had a wrong stamp."""
_SECOND_NS = 1e9
MOST_SHARE = 0.01
"""Of a period: by so much a deadline moves at most."""


def set_lock(c: Any, period_ns: int, time_constant_s: float, drift_ppm: float, within_us: float) -> None:
    """Fill a ``CLOCK_LOCK``; it locks when the error has been within `within_us` for a time constant."""
    c["present"], c["period_ns"] = 1, period_ns
    short = -math.expm1(-1e-9 * period_ns / time_constant_s)
    c["gain"], c["integral_gain"] = 2 * short, short**2
    c["most_ns"], c["drift"], c["within_ns"] = MOST_SHARE * period_ns, 1e-6 * drift_ppm, 1e3 * within_us
    c["settle_cycles"] = max(1, round(1e9 * time_constant_s / period_ns))


@compiled
def hear_clock(c: Any, sent_ns: int, stamp_ns: int, received_ns: int) -> None:
    """Take a frame that was sent and received at these times (CLOCK_MONOTONIC), with the device's stamp."""
    if received_ns < sent_ns:
        return
    low, high = float(stamp_ns - received_ns - c["apart_ns"]), float(stamp_ns - sent_ns - c["apart_ns"])
    passed_ns = float(max(0, received_ns - c["told_ns"]))
    moved, loose = passed_ns * c["gained_ns"] / c["period_ns"], passed_ns * c["drift"]
    lowest, highest = c["lowest_ns"] + moved - loose, c["highest_ns"] + moved + loose
    agrees = low <= highest and high >= lowest
    c["contradictions"] = 0 if agrees else c["contradictions"] + 1
    if c["known"] != 0 and agrees:
        c["lowest_ns"], c["highest_ns"] = max(low, lowest), min(high, highest)
    elif c["known"] == 0 or c["contradictions"] >= _IN_A_ROW:
        c["steps"] += c["known"]
        c["known"], c["contradictions"] = 1, 0
        c["apart_ns"] = stamp_ns - received_ns
        c["lowest_ns"], c["highest_ns"] = 0.0, float(received_ns - sent_ns)
    else:
        return
    c["told_ns"] = received_ns


@compiled
def late_ns(c: Any, deadline_ns: int) -> float:
    """How late a deadline comes on the grid of the device's clock: within half a period."""
    moved = (deadline_ns - c["told_ns"]) * c["gained_ns"] / c["period_ns"]
    middle = 0.5 * (c["lowest_ns"] + c["highest_ns"]) + moved
    whole = math.floor(middle)
    half = c["period_ns"] // 2
    phase = (deadline_ns + c["apart_ns"] + int(whole) + half) % c["period_ns"] - half
    return float(phase) + (middle - whole)


@compiled
def steer(c: Any, deadline_ns: int, periods: int, silent_cycles: int) -> None:
    """One cycle of the law: ``step_ns`` for the next deadline, and whether the loop is locked.

    `periods` after the one before: the clock's gain in missed periods is no error of the law, and is compensated at
    once. The lock is lost when error or drift was too large for `silent_cycles` in a row.
    """
    c["step_ns"][0] = 0
    if c["known"] == 0:
        return
    late, missed_ns = late_ns(c, deadline_ns), (periods - 1) * c["gained_ns"]
    error = late - missed_ns
    wanted = -(c["gain"] * error + c["gained_ns"] + missed_ns)
    step = min(max(wanted, -c["most_ns"]), c["most_ns"])
    most_gained = c["drift"] * c["period_ns"]
    if step == wanted:
        c["gained_ns"] = min(max(c["gained_ns"] + c["integral_gain"] * error, -most_gained), most_gained)
    whole = np.rint(step + c["rest_ns"])
    c["rest_ns"] += step - whole
    c["step_ns"][0] = int(whole)
    c["error_ns"] = late
    c["square_ns2"] += (late * late - c["square_ns2"]) * min(1.0, c["period_ns"] / _SECOND_NS)
    is_near = abs(late) <= c["within_ns"] and abs(c["gained_ns"]) < most_gained
    c["good"], c["bad"] = (c["good"] + 1, 0) if is_near else (0, c["bad"] + 1)
    if c["locked"] == 0 and c["good"] >= c["settle_cycles"]:
        c["locked"], c["square_ns2"] = 1, late * late
    elif c["locked"] != 0 and c["bad"] > silent_cycles:
        c["locked"] = 0
        c["unlocked"] += 1


@compiled
def forget_clock(c: Any) -> None:
    """Start again: another device, or the same after a power cycle."""
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
    if first or late_ns < -_JUMP_NS or c["late"] >= _LATE_IN_A_ROW:
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
