"""What a worker and the compiled loop that stands in for it (``serving.py``) tell each other."""

from __future__ import annotations

from micromanip.rt.record import record
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

MAX_TASKS = 16

VOLTAGE, SWITCH, UNUSED = range(3)
"""Kinds of output: goes through the gate; as the loop wants it; always at its safe value."""

TASK = record(
    ("period_ns", "i8"),
    ("due_ns", "i8"),
    ("performed", "i8"),
    ("outputs", "i8"),
    ("output", "i8", (MAX_OUTPUTS,)),
    ("given", "i8"),
    ("unconfirmed", "i8"),
    ("sent_ns", "i8"),
    ("fed_ns", "i8"),
    ("sent", "f8", (MAX_OUTPUTS,)),
)
"""One task: its grid, how often it was done, which outputs it writes, how often the device had taken those; whether it
has still to confirm the values `sent` last (of all outputs of the driver), at ``sent_ns``. What it took last was sent
at ``fed_ns``, 0 for nothing."""

OUTPUT = record(
    ("kind", "i8"),
    ("safe", "f8"),
    ("low", "f8"),
    ("high", "f8"),
    ("step", "f8"),
    ("last", "f8"),
    ("lowest", "f8"),
    ("highest", "f8"),
    ("rest", "f8"),
)
"""One output: its limits, what the device was given last, between which bounds that is known to lie, and where the
device's own watchdog leads it (`rest`)."""

STEADY = record(
    ("receive", "i8"),
    ("send", "i8"),
    ("context", "i8"),
    ("descriptor", "i8"),
    ("leave", "i8", (1,)),
    ("following", "i8"),
    ("look_ns", "i8"),
    ("dead_ns", "i8"),
    ("begins_ns", "i8"),
    ("until_ns", "i8"),
    ("decided_ns", "i8"),
    ("listened_ns", "i8"),
    ("tasks", "i8"),
    ("task", TASK, (MAX_TASKS,)),
    ("failed", "i8"),
    ("outputs", "i8"),
    ("output", OUTPUT, (MAX_OUTPUTS,)),
    ("wanted", "f8", (MAX_OUTPUTS,)),
    ("written_ns", "i8"),
    ("value", "f8", (MAX_OUTPUTS,)),
    ("noted", "f8", (MAX_OUTPUTS,)),
    ("memory_turn", "i8"),
    ("memory_seed", "i8"),
    ("memory_file", "i8"),
    ("memory_place", "i8", (2,)),
    ("refused", "i8"),
    ("skipped", "i8"),
    ("calls", "i8"),
    ("poll", "i4", (2,)),
    ("timespec", "i8", (2,)),
)
"""`receive` and `send` are addresses of the driver's two functions, `context` that of its record, `descriptor` what is
waited on. Python asks for its turn by `leave`. `value` is what was decided, `noted` what is remembered of what the
device was given (NaN: nobody knows), `failed` the task that the driver could not do. `poll` is a ``struct pollfd``."""

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
ASKED, STATE_CHANGES, LEFT_OVER, SILENT = 4, 5, 6, 7
"""Why the compiled loop returned, beside what ``send`` says: Python asked or a signal came, the outputs do not go on as
they were, the driver has left something to Python, the device's watchdog may have moved it."""
