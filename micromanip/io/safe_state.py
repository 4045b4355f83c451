"""The safe state of a bus' outputs: when they leave the loop's hand, how they come to rest, when they are let go again.

    FOLLOWING   the device is given what the loop decides
    SAFE_RAMP   smoothly to the safe values, from what the device was given last
    RESTING     at the safe values, until the loop itself asks for just these: then nothing jumps

A loop that is silent, a link that was lost and a worker that was restarted all lead to the ramp. It runs by the clock
and not by what could be sent: when a link comes back after the ramp's time, the first value sent is the safe one. The
loop has noticed the same fault, ramps by itself, and can't move again before it has been armed anew; that it asks for
the safe values is how the worker knows (``docs/decisions/0017-bus-workers.md``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.image import FOLLOWING, RESTING, SAFE_RAMP

Values = NDArray[np.float64]

VOLTAGE, SWITCH, LAST_SWITCH, UNUSED = "voltage", "switch", "last switch", "unused"
"""Kinds of output: goes on the ramp; to its safe value at once; at the end of the ramp; always there."""
_EQUAL_V = 1e-9


@dataclass(frozen=True)
class SafeOutput:
    """What the safe state must know of one output."""

    kind: str
    safe: float
    low: float = -math.inf
    high: float = math.inf


class SafeState:
    """Decides what the device is given."""

    def __init__(
        self, outputs: Sequence[SafeOutput], ramp_ns: int, dead_ns: int, last: Values | None = None, last_ns: int = 0
    ) -> None:
        """`last` is what the device was given at `last_ns`, by another worker; None if nothing ever was.

        A loop that has written nothing for `dead_ns` is dead.
        """
        self._outputs = outputs
        self._safe = np.array([output.safe for output in outputs])
        self._ramp_ns, self._dead_ns = ramp_ns, dead_ns
        self._last = self._safe.copy() if last is None else last.copy()
        self._start, self._start_ns = self._last.copy(), last_ns
        self.state = RESTING if last is None else SAFE_RAMP
        self.refused = 0
        """Values of the loop that were not finite or out of range; the one before was kept."""

    def leave(self, now_ns: int) -> None:
        """The device is not in the loop's hand any more."""
        if self.state == FOLLOWING:
            self.state, self._start, self._start_ns = SAFE_RAMP, self._last.copy(), now_ns

    def is_dead(self, written_ns: int, now_ns: int) -> bool:
        """Whether the loop, which wrote last at `written_ns`, has been silent for too long."""
        return now_ns - written_ns > self._dead_ns

    def values(self, wanted: Values, written_ns: int, now_ns: int) -> Values:
        """What the device is to be given now (n,), where the loop wanted `wanted` at `written_ns`."""
        dead = self.is_dead(written_ns, now_ns)
        if dead:
            self.leave(now_ns)
        share = (now_ns - self._start_ns) / self._ramp_ns
        if self.state == SAFE_RAMP and share >= 1.0:
            self.state = RESTING
        if self.state == RESTING and not dead and self._asks_for_rest(wanted):
            self.state = FOLLOWING
        if self.state == FOLLOWING:
            self._last = self._checked(wanted)
        elif self.state == SAFE_RAMP:
            self._last = self._on_the_way(share)
        else:
            self._last = self._safe.copy()
        return self._last

    def _asks_for_rest(self, wanted: Values) -> bool:
        return all(
            abs(wanted[i] - output.safe) <= _EQUAL_V for i, output in enumerate(self._outputs) if output.kind == VOLTAGE
        )

    def _checked(self, wanted: Values) -> Values:
        values = self._last.copy()
        for i, output in enumerate(self._outputs):
            if output.kind == UNUSED:
                continue
            if math.isfinite(wanted[i]) and output.low <= wanted[i] <= output.high:
                values[i] = wanted[i]
            else:
                self.refused += 1
        return values

    def _on_the_way(self, share: float) -> Values:
        rest = share * share * share * (10.0 + share * (6.0 * share - 15.0))  # no jump in speed at either end
        values = self._safe.copy()
        for i, output in enumerate(self._outputs):
            if output.kind == VOLTAGE:
                values[i] = self._start[i] + rest * (self._safe[i] - self._start[i])
            elif output.kind == LAST_SWITCH:
                values[i] = self._start[i]
        return values
