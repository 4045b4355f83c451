"""Whose turn it is: a worker's schedule (``rt/io/worker_records.py``), and what waits on the way to rest."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from micromanip.rt.io import worker_records as law
from micromanip.rt.jit import plain
from micromanip.rt.record import fields

from .driver import Task
from .safe_state import LAST_SWITCH, SafeOutput

_HELD_AGAIN_NS = 1_000_000
"""A write that was held back is tried again so soon."""
_FAILURES = 2
"""A task that has failed so often in a row comes after the others."""
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


class WayToRest:
    """Remembers what has failed since the outputs were at rest, over links that come and go.

    What fails keeps no other output from its safe value.
    """

    def __init__(self, tasks: Sequence[Task], outputs: Sequence[SafeOutput]) -> None:
        self.task_of = {i: number for number, task in enumerate(tasks) for i in task.outputs}
        """Number of the task that writes each output."""
        self._reads = {number for number, task in enumerate(tasks) if only_asks(task)}
        self._outputs = outputs
        self._failures: dict[int, int] = {}
        self._troubled = False

    def failed(self, number: int | None, *, broke: bool = False) -> None:
        """A task, or what came between two, has failed; `broke`: the link is lost with it."""
        self._troubled = True
        if number is not None and number in self.task_of.values():
            self._failures[number] = _FAILURES if broke else self._failures.get(number, 0) + 1

    def went_well(self, number: int) -> None:
        """A task has not failed."""
        if self._failures.get(number, _FAILURES) < _FAILURES:
            del self._failures[number]

    def arrived(self) -> None:
        """The outputs are at rest."""
        self._failures.clear()
        self._troubled = False

    def open_tasks(self, unsafe: Collection[int]) -> set[int]:
        """Tasks with outputs that are not at rest, of the `unsafe` ones, and don't wait for others."""
        first = [i for i in unsafe if self._outputs[i].kind != LAST_SWITCH] or unsafe
        return {self.task_of[i] for i in first}

    def waiting(self, unsafe: Collection[int]) -> set[int]:
        """Tasks that have no turn yet: reads, and what fails again and again while others are on their way."""
        if not self._troubled:
            return set()
        failing = {number for number, count in self._failures.items() if count >= _FAILURES}
        return self._reads | (failing if self.open_tasks(unsafe) - failing else set())
