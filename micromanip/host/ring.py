"""Reading the telemetry ring: any process, any number of readers, none of which the loop waits for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.mailbox import RING_HEAD


class RingReader:
    """Follows the ring from where it is; rows that were overwritten before they were read are counted.

    The loop publishes its head after a row is complete. A row is safe once, after the copy, the
    head is seen to be less than a whole ring further.
    """

    def __init__(self, ring: Any) -> None:
        self._words, self._rows = ring["words"], ring["rows"]
        self.position = int(self._words[RING_HEAD])
        self.lost = 0

    def read(self, most: int = 8192) -> NDArray[Any]:
        """Up to `most` new rows, oldest first; empty where there are none."""
        size = len(self._rows)
        head = int(self._words[RING_HEAD])
        start = max(self.position, head - size + 1)
        stop = min(head, start + most)
        begin, count = start % size, stop - start
        wrapped = max(0, begin + count - size)
        rows = np.concatenate([self._rows[begin : begin + count - wrapped], self._rows[:wrapped]])
        oldest_safe = int(self._words[RING_HEAD]) - size + 1
        torn = min(max(0, oldest_safe - start), len(rows))
        self.lost += start - self.position + torn
        self.position = stop
        kept: NDArray[Any] = rows[torn:]
        return kept

    def go_back(self, position: int, spare: int) -> None:
        """Begin with the row at `position`, or the oldest there is; `spare` of the oldest are left to the loop."""
        self.position = max(min(position, self.position), int(self._words[RING_HEAD]) - len(self._rows) + spare, 0)

    def latest(self) -> Any | None:
        """The newest row, without moving on; None before the first."""
        head = int(self._words[RING_HEAD])
        return self._rows[(head - 1) % len(self._rows)].copy() if head else None
