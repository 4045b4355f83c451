"""Records that a worker shares with its compiled turns (``worker_loop.py``): schedule, samples, file.

Each task of a bus is due on a grid of its own; missed turns are skipped. After a failure each write has a turn before
the next read: otherwise a read that always fails would block the writes for ever.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import arrays, record
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

from .gate import MAX_TASKS

SERVICE = record(
    ("receive", "i8"),
    ("send", "i8"),
    ("context", "i8"),
    ("descriptor", "i8"),
    ("leave", "i8", (1,)),
    ("look_ns", "i8"),
    ("until_ns", "i8"),
    ("listened_ns", "i8"),
    ("performed", "i8"),
    ("calls", "i8"),
    ("poll", "i4", (2,)),
    ("timespec", "i8", (2,)),
)
"""`receive` and `send` are addresses of the driver's two functions, `context` that of its record, `descriptor` what is
waited on. Python asks for its turn by `leave`. So many tasks were `performed`, and so many `calls` did something.
`poll` is a ``struct pollfd``."""

_PRIME, _FACTOR = 2147483647, 16777619
"""Every step fits into 64 bits with a sign, in compiled code as in Python."""


def size(values: int) -> int:
    """Words of a slot of the file of what a device was given last: its number, so many values, and a checksum."""
    return values + 2


def sealed(words: Any, seed: int) -> int:
    """The checksum of a slot, all its `words` but the last, which begins with `seed`."""
    check = int(seed) % _PRIME
    for i in range(len(words) - 1):
        word = int(words[i])
        check = (check * _FACTOR + (word & 0xFFFFFFFF)) % _PRIME
        check = (check * _FACTOR + (word >> 32 & 0xFFFFFFFF)) % _PRIME
    return check


MEMORY = record(
    *arrays("i8", 1, "turn", "seed", "file"), *arrays("i8", 2, "place"), *arrays("i8", size(MAX_OUTPUTS), "slot")
)
"""The file of what was given last (``bus/last_given.py``), -1 for none: the number of what was written last, the
checksum's seed, where the two slots lie, and what is written there."""

INBOX = record(
    ("signal", SIGNAL, (MAX_SIGNALS,)),
    ("missing", "i8", (MAX_SIGNALS,)),
    ("received", "i8"),
    ("lost", "i8"),
    ("confirmed", "i8", (MAX_TASKS,)),
)
"""Where a driver leaves its samples: as in the image, a sequence grows with each, also with those that never came,
which `missing` counts for each input and `lost` for all together. It puts 1 in `confirmed` for a task whose outputs the
device has taken, as they were sent last."""

NOTHING_SENT, SENT_IN_DOUBT, UNCONFIRMED = 1, 2, 3
"""What ``send`` returns where it sent nothing, where nobody knows, and where the device has still to confirm it, which
is nothing out of the ordinary."""
ASKED, ON_THE_RAMP, LEFT_OVER, SILENT = 4, 5, 6, 7
"""Why the compiled turns ended, beside what ``send`` says: Python asked or a signal came, the outputs are on their way
to rest, the driver has left something to Python, the device's watchdog may have moved it."""

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
    """Schedule the task's next turn: the first on its grid in the future."""
    if t["owed"][task] != 0:
        t["owed"][task] = 0
        t["due_ns"][task] = now_ns + t["period_ns"][task]  # never two values within a period
    else:
        t["skipped"][0] += max(0, pass_over(t, task, now_ns) - 1)


@compiled
def pass_over(t: Any, task: int, now_ns: int) -> int:
    """Skip the overdue turns of a task; how many."""
    t["owed"][task] = 0
    turns = max(0, (now_ns - t["due_ns"][task]) // t["period_ns"][task] + 1)
    t["due_ns"][task] += turns * t["period_ns"][task]
    return turns


@compiled
def owe(t: Any, task: int, at_ns: int) -> None:
    """A task that writes comes before anything is read, not before `at_ns`."""
    t["owed"][task], t["owed_ns"][task] = 1, at_ns
