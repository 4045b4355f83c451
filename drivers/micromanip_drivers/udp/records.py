"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver.wire import COUNTED, DEVICE_CLOCK, FRAME, GATE, SAMPLES, SOCKET, record

COUNTERS = ("received", "strangers", "wrong_length", "wrong_checksum", "not_this_datagram", "not_sent")
"""Datagrams that came; those of others, and three kinds of bad ones; datagrams that the system did not take."""

CONTEXT = record(
    ("opened", "i8"),
    ("counts", "i8"),
    ("gate", GATE),
    ("samples", SAMPLES),
    ("counted", COUNTED),
    ("clock", DEVICE_CLOCK),
    ("receive", FRAME),
    ("send", FRAME),
    ("socket", SOCKET),
    *((name, "i8") for name in COUNTERS),
)
