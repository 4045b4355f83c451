"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver.wire import COUNTED, DEVICE_CLOCK, FRAME, GATE, MAX_GROUPS, SOCKET, record

COUNTERS = ("received", "strangers", "wrong_length", "wrong_checksum", "not_this_datagram", "not_sent")
"""Datagrams that came; those of others, and three kinds of bad ones; datagrams that the system did not take."""

CONTEXT = record(
    ("opened", "i8"),
    ("counts", "i8"),
    ("gate", GATE),
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
"""``missing`` is scratch: samples of each group that are missing before the one that has come, -1 for none."""
