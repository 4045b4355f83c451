"""When the tasks of a bus are due: each on a grid of its own, what was missed is skipped.

After a failure each write has a turn of its own before anything is read again: a read that always fails would take the
line away from the writes for ever.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import arrays, record

from .gate import MAX_TASKS

TURNS = record(
    *arrays("i8", 1, "tasks", "skipped"),
    *arrays("i8", MAX_TASKS, "period_ns", "due_ns", "writes", "asks", "owed", "owed_ns"),
)
"""Of each task its period, when it is due, whether it ``writes`` outputs, and whether it only ``asks``: outputs come to
rest without it. Writes that are ``owed`` come before the next of these, not before ``owed_ns``. ``skipped`` turns were
left out because they came too late."""


@compiled
def turn_ns(t: Any, task: int) -> int:
    """When a task has its next turn."""
    return t["owed_ns"][task] if t["owed"][task] != 0 else t["due_ns"][task]


@compiled
def first_due(t: Any) -> int:
    """The task whose turn comes first, one that writes before one that does not; -1 where there is none."""
    first, first_ns, owed = -1, 0, False
    for k in range(t["tasks"][0]):
        owed = owed or t["owed"][k] != 0
    for k in range(t["tasks"][0]):
        due_ns = turn_ns(t, k)
        sooner = first < 0 or due_ns < first_ns or (due_ns == first_ns and t["writes"][k] > t["writes"][first])
        if sooner and not (owed and t["asks"][k] != 0):
            first, first_ns = k, due_ns
    return first


@compiled
def advance(t: Any, task: int, now_ns: int) -> None:
    """A task has its turn now; the next is the first on its grid that is still to come."""
    if t["owed"][task] != 0:
        t["owed"][task] = 0
        t["due_ns"][task] = now_ns + t["period_ns"][task]  # never two values within a period
    else:
        t["skipped"][0] += max(0, pass_over(t, task, now_ns) - 1)


@compiled
def pass_over(t: Any, task: int, now_ns: int) -> int:
    """A task loses the turns that it is due: so many."""
    t["owed"][task] = 0
    turns = max(0, (now_ns - t["due_ns"][task]) // t["period_ns"][task] + 1)
    t["due_ns"][task] += turns * t["period_ns"][task]
    return turns


@compiled
def owe(t: Any, task: int, at_ns: int) -> None:
    """A task that writes comes before anything is read, not before `at_ns`."""
    t["owed"][task], t["owed_ns"][task] = 1, at_ns
