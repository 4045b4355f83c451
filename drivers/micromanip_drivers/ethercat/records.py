"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver import Compiler
from micromanip.driver.wire import CLOCK_LOCK, MAX_BYTES, SOCKET, WIRE, record

compiled = Compiler(__file__)

BAD = ("wrong_length", "not_this_frame", "wrong_working_counter", "not_operating", "not_sent")
"""Two kinds of bad frames; those that a slave did not take part in, or that told of a slave which has left OP; frames
that the system did not take."""

MOST_TERMINALS = 8
WHOLE = -1
"""``cut_behind`` of a ring that is not cut."""

HALF = record(("count", "i8"), ("reached", "i8"), ("data", "u1", (MAX_BYTES,)))
"""A frame that some terminals only have acted on: its count (-1 for none) and how many these were."""

RING = record(
    ("present", "i8"),
    ("position_at", "i8"),
    ("clock_position_at", "i8"),
    ("way_ns", "i8"),
    ("inputs_at", "i8", (MOST_TERMINALS + 1,)),
    ("cut_behind", "i8"),
    ("cuts", "i8"),
    ("half", HALF, (2,)),
    ("socket", SOCKET),
)
"""The far end of a ring, and what came of a cut one: the last frame of each end. It was cut ``cuts`` times, the last
time behind so many terminals. Where it is whole a frame takes `way_ns` from the first clock to the last terminal;
`clock_position_at` is 0 without clocks."""

CONTEXT = record(
    *WIRE,
    ("terminals", "i8"),
    ("working_counter", "i8"),
    ("working_counter_at", "i8"),
    ("status_at", "i8"),
    ("al_status", "i8"),
    ("bring_ups", "i8"),
    ("delayed", "i8"),
    ("unusable", "i8"),
    ("not_this_frame", "i8"),
    ("wrong_working_counter", "i8"),
    ("not_operating", "i8"),
    ("lock", CLOCK_LOCK),
    ("time_at", "i8"),
    ("turn_ns", "i8"),
    ("ring", RING),
)
"""``al_status`` is that of all slaves, merged by `or`, as the last frame told it; ``bring_ups`` counts how often the
line was brought to OP. ``delayed`` frames came back, but not before the next cycle; so many are ``unusable`` in a row,
lost or with a wrong working counter. The first terminal's time is at `time_at` of the frame, which from there to the
end of the line and back takes `turn_ns`."""
