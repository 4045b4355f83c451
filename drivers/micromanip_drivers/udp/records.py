"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver.wire import COUNTED, DEVICE_CLOCK, FRAME, MAX_GROUPS, SOCKET, record

MAX_OUTPUTS = 8

FOLLOWING, QUIET, RESTING = range(3)
"""The device is given what the loop decides; nothing, until its watchdog has brought it to rest; its safe values."""

COUNTERS = (
    "received",
    "unanswered",
    "strangers",
    "wrong_length",
    "wrong_checksum",
    "not_this_datagram",
    "not_sent",
    "refused_values",
    "losses",
)
"""Datagrams that came; cycles without a fresh one; those of others, and three kinds of bad ones; datagrams that the
system did not take; outputs that were not finite or out of range, which stayed; how often the link was lost."""

CONTEXT = record(
    ("opened", "i8"),
    ("outputs", "i8"),
    ("state", "i8"),
    ("silent_cycles", "i8"),
    ("watchdog_ns", "i8"),
    ("still_ns", "i8"),
    ("unanswered_in_a_row", "i8"),
    ("answers", "i8"),
    ("sent_ns", "i8"),
    ("count", "i8"),
    ("counts", "i8"),
    ("rest", "f8", (MAX_OUTPUTS,)),
    ("switch", "i8", (MAX_OUTPUTS,)),
    ("given", "f8", (MAX_OUTPUTS,)),
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
"""``still_ns`` after the last datagram all outputs are at rest by the device's watchdog; ``given`` is what it was sent
last; ``missing`` is scratch: samples of each group that are missing before the one that has come, -1 for none."""
