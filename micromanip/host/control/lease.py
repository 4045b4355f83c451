"""A lease on what somebody has begun: they ask for it again and again, or it ends."""

from __future__ import annotations

import time
from collections.abc import Callable

_MOST_LOOKS = 2.0
"""What one look counts for at most, in terms of the time between two."""


class Lease:
    """Time without anybody asking, as the host has seen it.

    A host that was held up itself finds the client's questions only after its own look: its delay is not the client's
    silence, so a look counts for little more than the time between two.
    """

    def __init__(self, seconds: float, look_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """It runs out after `seconds`, looked at every `look_s`."""
        self.seconds, self._most_s, self._clock = seconds, _MOST_LOOKS * look_s, clock
        self._unasked_s, self._looked_s = 0.0, clock()

    def renew(self) -> None:
        """Somebody has asked."""
        self._unasked_s, self._looked_s = 0.0, self._clock()

    def ran_out(self) -> bool:
        """Whether nobody has asked for so long; asked at each look."""
        now_s = self._clock()
        self._unasked_s += min(now_s - self._looked_s, self._most_s)
        self._looked_s = now_s
        return self._unasked_s > self.seconds
