"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver.wire import CLOCK_LOCK, WIRE, record

BAD = ("wrong_length", "not_this_frame", "wrong_working_counter", "not_operating", "not_sent")
"""Two kinds of bad frames; those that a slave did not take part in, or that told of a slave which has left OP; frames
that the system did not take."""

CONTEXT = record(
    *WIRE,
    ("terminals", "i8"),
    ("working_counter", "i8"),
    ("working_counter_at", "i8"),
    ("status_at", "i8"),
    ("al_status", "i8"),
    ("bring_ups", "i8"),
    ("wait_ns", "i8"),
    ("news", "i8"),
    ("not_this_frame", "i8"),
    ("wrong_working_counter", "i8"),
    ("not_operating", "i8"),
    ("lock", CLOCK_LOCK),
    ("time_at", "i8"),
)
"""``al_status`` is that of all slaves, merged by `or`, as the last frame told it; ``bring_ups`` counts how often the
line was brought to OP. The loop waits for its frame until `wait_ns` after the deadline; `news` were acknowledged so.
The first terminal's time is at `time_at` of the frame."""
