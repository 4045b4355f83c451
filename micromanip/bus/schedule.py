"""The schedule of a worker's tasks (``rt/io/worker_records.py``) for Python."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from micromanip.rt.io import worker_records as law
from micromanip.rt.jit import plain
from micromanip.rt.record import fields

from .driver import Task

_HELD_AGAIN_NS = 1_000_000
"""A write that was held back is tried again so soon."""
_first_due, _turn_ns, _advance, _pass_over, _owe = map(
    plain, (law.first_due, law.turn_ns, law.advance, law.pass_over, law.owe)
)


class Schedule:
    """Due times (ns) of the tasks; the one that has waited longest comes first."""

    def __init__(self, tasks: Sequence[Task], now_ns: int) -> None:
        self.record = np.zeros(1, law.TURNS)
        self._turns = t = fields(self.record[0])
        t["tasks"][0] = len(tasks)
        for number, task in enumerate(tasks):
            t["period_ns"][number], t["due_ns"][number] = round(1e9 / task.rate_hz), now_ns
            t["writes"][number], t["asks"][number] = bool(task.outputs), only_asks(task)

    @property
    def skipped(self) -> int:
        """Turns that were left out because they came too late."""
        return int(self._turns["skipped"][0])

    def next_ns(self) -> int | None:
        """When the next task is due; None if there is none at all."""
        number = _first_due(self._turns)
        return None if number < 0 else int(_turn_ns(self._turns, number))

    def take(self, now_ns: int, passed_over: Collection[int] = ()) -> int | None:
        """Number of the task to do now, if one is due; its next turn is the first on its grid that is still to come.

        The ones that are `passed_over` lose the turns that they are due.
        """
        for task in passed_over:
            _pass_over(self._turns, task, now_ns)
        number: int = _first_due(self._turns)
        if number < 0 or _turn_ns(self._turns, number) > now_ns:
            return None
        _advance(self._turns, number, now_ns)
        return number

    def failed(self, number: int | None) -> None:
        """A task, or what came between two, has failed: each other write has its turn before the next read."""
        t = self._turns
        for task in range(t["tasks"][0]):
            if t["writes"][task] and task != number and not t["owed"][task]:
                _owe(t, task, t["due_ns"][task])

    def held(self, number: int, now_ns: int) -> None:
        """A task was held back: one that writes is tried again soon, and before anything is read."""
        if self._turns["writes"][number]:
            _owe(self._turns, number, now_ns + _HELD_AGAIN_NS)


def only_asks(task: Task) -> bool:
    """Whether outputs come to rest without it."""
    return not task.outputs and not task.serves_outputs
