"""The device's own time stamps in CLOCK_MONOTONIC: what the way to us adds, and how it varies, is taken out.

A message can be late, never early. So the smallest difference between our time of reception and the device's time is
the best guess of how far the clocks are apart, and it is too large by the shortest way only. The difference is let
grow by the rate at which two clocks may drift, so that a clock that is slower than ours is followed.
"""

from __future__ import annotations

import math

_DRIFT_PPM = 100
_JUMP_NS = 200_000_000
_IN_A_ROW = 5
"""So many messages in a row that come later than this beyond the best: the clock was set back, they are not late."""


class DeviceClock:
    """Converts time stamps that wrap after `counts` units of `unit_s`; None for a clock that does not wrap."""

    def __init__(self, unit_s: float, counts: int | None) -> None:
        self._unit_s, self._counts = unit_s, counts
        self._stamp: float | None = None
        self._turns = 0
        self._apart_ns = 0
        self._received_ns = 0
        self._late = 0
        self.steps = 0
        """How often the clock was set."""

    def forget(self) -> None:
        """Begin anew: another device, or a new connection."""
        self._stamp, self._turns, self._late = None, 0, 0

    def taken_ns(self, stamp: float, received_ns: int) -> int:
        """When a message with this stamp, which came at `received_ns`, was stamped; never after it came."""
        if not math.isfinite(stamp):
            return received_ns
        first = self._stamp is None
        device_ns = self._unwrapped_ns(stamp)
        apart_ns = received_ns - device_ns
        late_ns = apart_ns - self._apart_ns
        self._late = self._late + 1 if late_ns > _JUMP_NS else 0
        if first or late_ns < -_JUMP_NS or self._late >= _IN_A_ROW:
            self.steps += not first
            self._apart_ns, self._late = apart_ns, 0
        else:
            drift_ns = max(0, received_ns - self._received_ns) * _DRIFT_PPM // 1_000_000
            self._apart_ns = min(apart_ns, self._apart_ns + drift_ns)
        self._received_ns = received_ns
        return min(received_ns, device_ns + self._apart_ns)

    def _unwrapped_ns(self, stamp: float) -> int:
        if self._stamp is not None and self._counts is not None:
            ahead = stamp - self._stamp
            self._turns += (ahead < -self._counts / 2) - (ahead > self._counts / 2)
        self._stamp = stamp
        return round((stamp + self._turns * (self._counts or 0)) * self._unit_s * 1e9)
