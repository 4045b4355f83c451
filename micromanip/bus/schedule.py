"""When the tasks of a bus are due: each on a grid of its own, what was missed is skipped.

After a failure each write has a turn of its own before anything is read again: a read that always fails would take the
line away from the writes for ever.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from .driver import Task

_HELD_AGAIN_NS = 1_000_000
"""A write that was held back is tried again so soon."""


class Schedule:
    """Due times (ns) of the tasks; the one that has waited longest comes first."""

    def __init__(self, tasks: Sequence[Task], now_ns: int) -> None:
        self._period_ns = [round(1e9 / task.rate_hz) for task in tasks]
        self._due_ns = [now_ns for _ in tasks]
        self._writes = {number for number, task in enumerate(tasks) if task.outputs}
        self._waits = {number for number, task in enumerate(tasks) if only_asks(task)}
        self._owed_ns: dict[int, int] = {}
        """Writes that come before the next read, and not before when."""
        self.skipped = 0
        """Turns that were left out because they came too late."""

    def next_ns(self) -> int | None:
        """When the next task is due; None if there is none at all."""
        return min(self._turns(()), default=(None,))[0]

    def take(self, now_ns: int, passed_over: Collection[int] = ()) -> int | None:
        """Number of the task to do now, if one is due; its next turn is the first on its grid that is still to come.

        The ones that are `passed_over` lose the turns that they are due.
        """
        for task in passed_over:
            self._pass(task, now_ns)
            self._owed_ns.pop(task, None)
        due_ns, _, task = min(self._turns(passed_over), default=(now_ns + 1, True, 0))
        if due_ns > now_ns:
            return None
        if self._owed_ns.pop(task, None) is not None:
            self._due_ns[task] = now_ns + self._period_ns[task]  # never two values within a period
        else:
            self.skipped += max(0, self._pass(task, now_ns) - 1)
        return task

    def failed(self, number: int | None) -> None:
        """A task, or what came between two, has failed: each other write has its turn before the next read."""
        self._owed_ns |= {write: self._due_ns[write] for write in self._writes - {number} - self._owed_ns.keys()}

    def held(self, number: int, now_ns: int) -> None:
        """A task was held back: one that writes is tried again soon, and before anything is read."""
        if number in self._writes:
            self._owed_ns[number] = now_ns + _HELD_AGAIN_NS

    def _turns(self, passed_over: Collection[int]) -> list[tuple[int, bool, int]]:
        """When each task that may have one has its next turn, those that write first, and its number."""
        waiting = self._waits if self._owed_ns else ()
        return [
            (self._owed_ns.get(number, due_ns), number not in self._writes, number)
            for number, due_ns in enumerate(self._due_ns)
            if number not in waiting and number not in passed_over
        ]

    def _pass(self, task: int, now_ns: int) -> int:
        """Go to the next turn of a task; how many it has had."""
        turns = max(0, (now_ns - self._due_ns[task]) // self._period_ns[task] + 1)
        self._due_ns[task] += turns * self._period_ns[task]
        return turns

    def lend(self, rows: Any) -> None:
        """Let the compiled loop go on from here: `rows` are TASK records."""
        for row, period_ns, due_ns in zip(rows, self._period_ns, self._due_ns, strict=False):
            row["period_ns"], row["due_ns"], row["performed"] = period_ns, due_ns, 0

    def take_back(self, rows: Any, skipped: int) -> None:
        """Go on from where the compiled loop is."""
        self._due_ns = rows["due_ns"][: len(self._due_ns)].tolist()
        self.skipped += skipped


def only_asks(task: Task) -> bool:
    """Whether outputs come to rest without it."""
    return not task.outputs and not task.serves_outputs
