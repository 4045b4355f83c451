"""The counter of a device's packets: what is fresh, and what is missing; one law for Python and compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from .compiled import compiled
from .frame_options import Number
from .number import NumberCodec
from .records import COUNTER

STALE = -1
_MOST_BITS = 32
"""Of a wider counter the lowest bits count as well."""
_RESTARTED_AFTER = 3
"""So many packets in a row that go on from a count in the past: the device began anew, it is no reordering."""


@compiled
def missing_before(c: Any, count: int, step: int) -> int:
    """How far a packet's count is ahead of what was to come next; the one after it is `step` further. STALE: not fresh.

    A number that was there already is no news: the device repeats itself, or is frozen. One from the past, by less than
    half of the counter's range, was overtaken on its way. Neither is fresh.
    """
    count = count & c["mask"]
    after = (count + step) & c["mask"]
    missing = (count - c["next"]) & c["mask"] if c["known"] != 0 else 0
    if missing > c["mask"] >> 1:
        c["in_order"] = c["in_order"] + 1 if c["past"] != 0 and count == c["next_of_past"] else 1
        c["past"], c["next_of_past"] = 1, after
        if c["in_order"] <= _RESTARTED_AFTER:
            c["stale"] += 1
            return STALE
        c["restarts"] += 1
        missing = 0
    c["known"], c["next"], c["past"], c["in_order"] = 1, after, 0, 0
    return missing


class PacketCounter:
    """Counts what is missing; `by_sample`: the number is that of the packet's first sample, else that of the packet.

    Compiled code may go on with its record.
    """

    def __init__(self, options: Number, by_sample: bool = False) -> None:
        self._codec, self._by_sample = NumberCodec(options), by_sample
        self.record = np.zeros(1, COUNTER)[0]
        self.record["mask"] = (1 << min(8 * options.size, _MOST_BITS)) - 1

    def move_to(self, record: Any) -> None:
        """Count in this record from now on."""
        for name in COUNTER.names or ():
            record[name] = self.record[name]
        self.record = record

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self.record["known"] = self.record["past"] = 0

    def lost_before(self, packet: bytes, samples: int = 1) -> int | None:
        """Samples known to be missing before the `samples` of a packet; None for a packet that is not fresh."""
        count = int(self._codec.read(packet)) & int(self.record["mask"])
        missing = int(missing_before(self.record, count, samples if self._by_sample else 1))
        if missing == STALE:
            return None
        lost = missing if self._by_sample else missing * samples
        self.record["lost"] += lost
        return lost

    @property
    def lost(self) -> int:
        """Samples that are known to be missing, up to now."""
        return int(self.record["lost"])

    @property
    def stale(self) -> int:
        """Packets that were not fresh."""
        return int(self.record["stale"])

    @property
    def restarts(self) -> int:
        """How often the device began anew."""
        return int(self.record["restarts"])
