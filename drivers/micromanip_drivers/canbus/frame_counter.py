"""The counter of a message: what is fresh, and what is missing before it; one law for Python and compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from .compiled import compiled
from .records import COUNTER

STALE = -1
_MOST_BITS = 32
"""Of a wider counter the lowest bits count as well."""
_RESTARTED_AFTER = 3
"""So many frames in a row that go on from a count in the past: the device began anew, it is no reordering."""


@compiled
def missing_before(c: Any, count: int) -> int:
    """Frames known to be missing before the one with this count; STALE for a frame that is not fresh.

    A count that was there already is no news: the device repeats itself, or is frozen. One from the past, by less than
    half of the counter's range, was overtaken on its way. Neither is a fresh sample.
    """
    count = count % c["modulus"]
    if c["known"] == 0:
        c["known"], c["last"] = 1, count
        return 0
    ahead = (count - c["last"]) % c["modulus"]
    if ahead == 0:
        c["repeated"] += 1
        return STALE
    if ahead > c["modulus"] // 2:
        goes_on = c["past"] >= 0 and count == (c["past"] + 1) % c["modulus"]
        c["in_order"] = c["in_order"] + 1 if goes_on else 1
        c["past"] = count
        if c["in_order"] <= _RESTARTED_AFTER:
            c["out_of_order"] += 1
            return STALE
        c["restarts"] += 1
        ahead = 1
    c["last"], c["past"] = count, -1
    missing: int = ahead - 1
    c["lost"] += missing
    return missing


class FrameCounter:
    """Follows the counter of one message, in a record that compiled code may go on with."""

    def __init__(self, bits: int) -> None:
        self.record = np.zeros(1, COUNTER)[0]
        self.record["modulus"] = 1 << min(bits, _MOST_BITS)
        self.forget()

    def move_to(self, record: Any) -> None:
        """Follow it in this record from now on."""
        for name in COUNTER.names or ():
            record[name] = self.record[name]
        self.record = record

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self.record["known"], self.record["past"] = 0, -1

    def lost_before(self, count: int) -> int | None:
        """Frames known to be missing before the one with this count; None for a frame that is not fresh."""
        missing = missing_before(self.record, count)
        return None if missing == STALE else int(missing)

    def counted(self, name: str) -> int:
        """What it has counted: lost, repeated, out_of_order, restarts."""
        return int(self.record[name])
