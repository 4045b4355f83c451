"""What a worker and its compiled turns (``worker_loop.py``) tell each other beside gate, schedule and image."""

from __future__ import annotations

from typing import Any

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
