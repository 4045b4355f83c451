"""The PDOs of a configuration as tables, and our SYNCs: what the compiled functions (``exchange.py``) go by."""

from __future__ import annotations

from pathlib import Path

from micromanip.driver import Compiler
from micromanip.driver.wire import record

from ..canbus.records import FRAMES, MAX_MESSAGES

compiled = Compiler(__file__, also=(Path(__file__).parents[1] / "canbus",))

REMEMBERED = 16
"""So many of our last SYNCs are."""

SYNCS = record(("count", "i8"), ("kept", "i8"), ("sent_ns", "i8", (REMEMBERED,)))
"""Our SYNCs: how many there were, how many of the last are known, and when those went out."""

SAMPLING = record(
    ("every", "i8"),
    ("frame_ns", "i8"),
    ("latency_ns", "i8"),
    ("lasting_ns", "i8"),
    ("waiting_ns", "i8"),
    ("least_ns", "i8"),
    ("answered", "i8"),
    ("came", "i8"),
    ("last", "u8"),
)
"""A PDO that comes: each `every` n-th SYNC is answered within `lasting_ns`, 0 for one that comes by itself; it waits
for the bus for `waiting_ns` at worst. The SYNC that was answered last (0: none since the opening), the least time that
an answer took since then, the PDO that came last."""

CONTEXT = record(
    *FRAMES,
    ("sampling", SAMPLING, (MAX_MESSAGES,)),
    ("syncs", SYNCS),
    ("sync_task", "i8"),
    ("sync_frame_ns", "i8"),
    ("overdue_ns", "i8"),
    ("pdos", "i8"),
    ("lost", "i8"),
    ("repeated", "i8"),
)
"""The driver as compiled code sees it: one `sampling` for each message that is received, the task that is the SYNC (-1:
none) and how long that is on the bus; from `overdue_ns` on a heartbeat is missing, which Python judges."""
