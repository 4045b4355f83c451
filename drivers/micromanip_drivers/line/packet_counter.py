"""The counter that a device puts into its frames or packets: what is new, what is missing, what stands still."""

from __future__ import annotations

from .field_options import Number
from .number import NumberCodec

_RESTARTED_AFTER = 3
"""So many packets in a row that go on from a count in the past: the device began anew, it is no reordering."""


class PacketCounter:
    """Counts what is missing; `by_sample`: the number is that of the packet's first sample, else that of the packet.

    A number that was there already is no news: the device repeats itself, or is frozen. One from the past, by less than
    half of the counter's range, was overtaken on its way. Neither is fresh.
    """

    def __init__(self, options: Number, by_sample: bool = False) -> None:
        self._codec = NumberCodec(options)
        self._by_sample = by_sample
        self._counts = self._codec.counts
        self._next: int | None = None
        self._next_of_past: int | None = None
        self._in_order = 0
        self.lost = self.stale = self.restarts = 0

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self._next = self._next_of_past = None

    def lost_before(self, packet: bytes, samples: int = 1) -> int | None:
        """Samples known to be missing before the `samples` of a packet; None for a packet that is not fresh."""
        count = int(self._codec.read(packet))
        after = (count + (samples if self._by_sample else 1)) % self._counts
        missing = 0 if self._next is None else (count - self._next) % self._counts
        if missing >= self._counts // 2:
            if not self._began_anew(count, after):
                self.stale += 1
                return None
            self.restarts += 1
            missing = 0
        self._next, self._next_of_past, self._in_order = after, None, 0
        lost = missing if self._by_sample else missing * samples
        self.lost += lost
        return lost

    def _began_anew(self, count: int, after: int) -> bool:
        self._in_order = self._in_order + 1 if count == self._next_of_past else 1
        self._next_of_past = after
        return self._in_order > _RESTARTED_AFTER
