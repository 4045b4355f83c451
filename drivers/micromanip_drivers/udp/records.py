"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver.wire import COUNTED, DEVICE_CLOCK, FRAME, MAX_GROUPS, SOCKET, record

MAX_OUTPUTS = 8

FOLLOWING, QUIET, RESTING = range(3)
"""The device is given what the loop decides; nothing, until its watchdog has brought it to rest; its safe values."""

ANSWERS = 3
"""So many answers, and the device counts as there again."""
RECENT = 64
"""So many of the last datagrams are remembered; an older one that is acknowledged says nothing new."""

COUNTERS = (
    "received",
    "unanswered",
    "strangers",
    "wrong_length",
    "wrong_checksum",
    "not_this_datagram",
    "not_sent",
    "refused_values",
    "held_back",
    "losses",
)
"""Datagrams that came; cycles without a fresh one; those of others, and three kinds of bad ones; datagrams that the
system did not take; outputs that were not finite or out of range, which stayed; outputs that had to wait for the
device, which may still have had an older one; how often the link was lost."""

CONTEXT = record(
    ("opened", "i8"),
    ("outputs", "i8"),
    ("state", "i8"),
    ("silent_cycles", "i8"),
    ("watchdog_ns", "i8"),
    ("still_ns", "i8"),
    ("unanswered_in_a_row", "i8"),
    ("answers", "i8"),
    ("begun", "i8"),
    ("sent_ns", "i8"),
    ("sent_count", "i8"),
    ("counts", "i8"),
    ("acknowledged", "i8"),
    ("rest", "f8", (MAX_OUTPUTS,)),
    ("switch", "i8", (MAX_OUTPUTS,)),
    ("step", "f8", (MAX_OUTPUTS,)),
    ("given", "f8", (MAX_OUTPUTS,)),
    ("recent", "f8", (RECENT, MAX_OUTPUTS)),
    ("lowest", "f8", (MAX_OUTPUTS,)),
    ("highest", "f8", (MAX_OUTPUTS,)),
    ("group_count", "i8", (MAX_GROUPS,)),
    ("group_known", "i8", (MAX_GROUPS,)),
    ("missing", "i8", (MAX_GROUPS,)),
    ("counted", COUNTED),
    ("clock", DEVICE_CLOCK),
    ("receive", FRAME),
    ("send", FRAME),
    ("socket", SOCKET),
    *((name, "i8") for name in COUNTERS),
)
"""``still_ns`` after the last datagram all outputs are at rest by the device's watchdog. ``step`` is what two values
that the device gets one after the other may differ by; ``given`` is what it was sent last, ``recent`` that of each
of the last datagrams, and what it has lies between ``lowest`` and ``highest``. ``sent_count`` datagrams were sent,
of which the device has said that it has acted on the one before ``acknowledged``. ``missing`` is scratch: samples
of each group that are missing before the one that has come, -1 for none."""
