"""When the tasks of a bus are due: each on a grid of its own, what was missed is skipped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .driver import Task


class Schedule:
    """Due times (ns) of the tasks; the one that has waited longest comes first."""

    def __init__(self, tasks: Sequence[Task], now_ns: int) -> None:
        self._period_ns = [round(1e9 / task.rate_hz) for task in tasks]
        self._due_ns = [now_ns for _ in tasks]
        self.skipped = 0
        """Turns that were left out because they came too late."""

    def next_ns(self) -> int | None:
        """When the next task is due; None if there is none at all."""
        return min(self._due_ns, default=None)

    def take(self, now_ns: int) -> int | None:
        """Number of the task to do now, if one is due; its next turn is the first on its grid that is still to come."""
        if not self._due_ns:
            return None
        task = min(range(len(self._due_ns)), key=self._due_ns.__getitem__)
        if self._due_ns[task] > now_ns:
            return None
        turns = (now_ns - self._due_ns[task]) // self._period_ns[task] + 1
        self._due_ns[task] += turns * self._period_ns[task]
        self.skipped += turns - 1
        return task

    def lend(self, rows: Any) -> None:
        """Let the compiled loop go on from here: `rows` are TASK records."""
        for row, period_ns, due_ns in zip(rows, self._period_ns, self._due_ns, strict=False):
            row["period_ns"], row["due_ns"], row["performed"] = period_ns, due_ns, 0

    def take_back(self, rows: Any, skipped: int) -> None:
        """Go on from where the compiled loop is."""
        self._due_ns = rows["due_ns"][: len(self._due_ns)].tolist()
        self.skipped += skipped
