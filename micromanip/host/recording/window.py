"""Which rows of the telemetry a recording takes: all from a cycle on, or those around a trigger, exact to the cycle."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

FAULT, OVERRUN, MARK = "fault", "overrun", "mark"
"""Triggers: a fault that is latched, a deadline that was missed, `recording mark`."""

_LATE = 10_000
"""Cycles: a mark comes through two processes, and finds rows from before it still there."""


class Window:
    """Holds rows back until something happens; then lets those before it through, and those after it for a while.

    Without triggers everything passes.
    """

    def __init__(self, triggers: Sequence[str], before: int, after: int) -> None:
        """`before` and `after` are cycles; a trigger comes once."""
        self._triggers, self._before, self._after = frozenset(triggers), before, after
        self._held: deque[NDArray[Any]] = deque()
        self._states: list[Any] = []
        self._faulted = True  # a fault that was there before is none that comes
        self.trigger_cycle: int | None = None
        self.cause: str | None = None

    @property
    def is_armed(self) -> bool:
        """Whether it still waits."""
        return bool(self._triggers) and self.trigger_cycle is None

    def is_over(self, newest_cycle: int) -> bool:
        """Whether all that was wanted has passed."""
        return self.trigger_cycle is not None and newest_cycle >= self.trigger_cycle + self._after

    def marked(self, cycle: int) -> None:
        """Somebody has set a mark at `cycle`."""
        if self.is_armed and MARK in self._triggers:
            self.trigger_cycle, self.cause = cycle, MARK

    def keep(self, state: Any) -> None:
        """Hold a snapshot of the loop back with the rows."""
        if self.is_armed:
            oldest = int(state["cycle"]) - self._before - _LATE
            self._states = [each for each in self._states if each["cycle"] >= oldest]
        self._states.append(state)

    def states(self) -> list[Any]:
        """Snapshots that are to be recorded now."""
        if self.is_armed:
            return []
        first = 0 if self.trigger_cycle is None else self.trigger_cycle - self._before - 1
        passed, self._states = [state for state in self._states if state["cycle"] >= first], []
        return passed

    def take(self, rows: NDArray[Any]) -> list[NDArray[Any]]:
        """What of the rows so far is to be recorded now, in order."""
        if not self._triggers:
            return [rows]
        if self.is_armed:
            self._look(rows)
        self._held.append(rows)
        if self.trigger_cycle is None:
            newest = int(rows["cycle"][-1]) if len(rows) else 0
            while self._held and (not len(self._held[0]) or self._held[0]["cycle"][-1] < newest - self._before - _LATE):
                self._held.popleft()
            return []
        first, last = self.trigger_cycle - self._before, self.trigger_cycle + self._after
        passed = [part[(part["cycle"] >= first) & (part["cycle"] <= last)] for part in self._held]
        self._held.clear()
        return passed

    def _look(self, rows: NDArray[Any]) -> None:
        if not len(rows):
            return
        found: list[tuple[int, str]] = []
        if FAULT in self._triggers:
            faulty = rows["fault"] != 0
            rises = faulty & ~np.concatenate([[self._faulted], faulty[:-1]])
            found += [(int(np.argmax(rises)), FAULT)] if rises.any() else []
            self._faulted = bool(faulty[-1])
        if OVERRUN in self._triggers:
            missed = rows["periods"] > 1
            found += [(int(np.argmax(missed)), OVERRUN)] if missed.any() else []
        if found:
            at, self.cause = min(found)
            self.trigger_cycle = int(rows["cycle"][at])
