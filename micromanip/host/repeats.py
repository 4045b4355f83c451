"""Refusals that come again and again: the first is told, the others of the next minute are counted.

So a client that asks for the impossible a thousand times a second neither fills the disk nor hides what others do.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from micromanip.replies import AuditEntry

_WINDOW_S = 60.0
_DISTINCT = 10
_Key = tuple[str, int | None, str | None, str | None]


@dataclass
class _Seen:
    until: float
    newest: AuditEntry
    count: int = 0


class Repeats:
    """What was refused within the last minute; a user has so many `distinct` refusals, more are counted together."""

    def __init__(
        self, window_s: float = _WINDOW_S, distinct: int = _DISTINCT, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._window_s, self._distinct, self._clock = window_s, distinct, clock
        self._seen: dict[_Key, _Seen] = {}

    def is_counted(self, entry: AuditEntry) -> bool:
        """Take note of a refusal; True where it is counted with others and needs no line of its own."""
        user: tuple[str, int | None] = (entry["user"], entry["uid"])
        key: _Key = (*user, entry["verb"], entry["reason"])
        is_new = key not in self._seen
        if is_new and Counter(known[:2] for known in self._seen)[user] >= self._distinct:
            key = (*user, None, None)
        seen = self._seen.setdefault(key, _Seen(self._clock() + self._window_s, entry))
        if is_new and key[2] is not None:
            return False
        seen.newest, seen.count = entry, seen.count + 1
        return True

    def over(self, *, now: bool = False) -> list[AuditEntry]:
        """The newest of those whose minute is over (all of them: `now`), each with how many were counted."""
        ended = [key for key, seen in self._seen.items() if now or seen.until <= self._clock()]
        found = [self._seen.pop(key) for key in ended]
        return [AuditEntry(**{**seen.newest, "repeated": seen.count}) for seen in found if seen.count]
