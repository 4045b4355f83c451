"""Who has a turn on the way to rest, where something fails: what keeps no other output from its safe value."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from .driver import Task
from .safe_state import LAST_SWITCH, SafeOutput
from .schedule import only_asks

_FAILURES = 2
"""A task that has failed so often in a row comes after the others."""


class WayToRest:
    """Remembers what has failed since the outputs were at rest, over links that come and go."""

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
