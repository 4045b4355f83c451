"""Lines of the gateway about what others do: so few that none who asks often fills the journal."""

from __future__ import annotations

import time
from collections.abc import Callable

_AGAIN_S = 60.0


class Teller:
    """Says a state when it changes, and events at most once a minute."""

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock = say, clock
        self._told: str | None = None
        self._next_s, self._silent = -1.0, 0

    def state(self, text: str) -> None:
        """That it is so now."""
        if text != self._told:
            self._told = text
            self._say(text)

    def event(self, text: str) -> None:
        """That it has happened; of many the number."""
        now_s = self._clock()
        if now_s < self._next_s:
            self._silent += 1
            return
        more = f" ({self._silent} more since the last line)" if self._silent else ""
        self._next_s, self._silent = now_s + _AGAIN_S, 0
        self._say(text + more)
