"""The counter of a device's packets, for Python and compiled code in turn: both go on in one record."""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.rt.io.counting import COUNTED, OLD, missing_before
from micromanip.rt.record import move

_MOST_BITS = 32
"""Of a wider counter the lowest bits count as well."""


class DeviceCounter:
    """A counter of so many `bits`."""

    def __init__(self, bits: int) -> None:
        self.record = np.zeros(1, COUNTED)[0]
        self.record["counts"] = 1 << min(bits, _MOST_BITS)

    def move_to(self, record: Any) -> None:
        """Count in this record from now on, from where it stands."""
        self.record = move(self.record, record)

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self.record["known"] = self.record["in_a_row"] = 0

    def lost_before(self, count: int, step: int = 1) -> int | None:
        """What is known to be missing before `count`, where the one after it is `step` further; None: it is not fresh.

        A device that has begun anew is fresh, and nothing is known to be missing.
        """
        missing = int(missing_before(self.record, count % int(self.record["counts"]), step))
        return None if missing == OLD else max(0, missing)

    def counted(self, name: str) -> int:
        """What was counted: lost, doubled, late, restarts."""
        return int(self.record[name])
