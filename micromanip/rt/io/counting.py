"""A device's counter: new, missing, duplicate and overtaken samples, and restarts."""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import record

COUNTED = record(
    ("counts", "i8"),
    ("known", "i8"),
    ("last", "i8"),
    ("next", "i8"),
    ("next_of_past", "i8"),
    ("in_a_row", "i8"),
    ("lost", "i8"),
    ("doubled", "i8"),
    ("late", "i8"),
    ("restarts", "i8"),
)
"""A counter that wraps after `counts` (at most 2**32), where it stands, and what was counted since the start.

`next` is what is to come, `next_of_past` what would follow the last one that was not fresh.
"""

OLD, RESTARTED = -1, -2
"""What ``missing_before`` returns for a count that is not fresh, and for the first one after a restart."""
_RESTARTED_AFTER = 3
"""After so many consecutive counts from the past the device has restarted; they were not overtaken."""


@compiled
def missing_before(c: Any, count: int, step: int = 1) -> int:
    """How far `count` is ahead of what was to come, the one after it being `step` further; OLD, RESTARTED.

    A repeated count is not fresh: device or network sent it twice. A count from the past, by less than half of the
    range, was overtaken.
    """
    count = count % c["counts"]
    after = (count + step) % c["counts"]
    missing: int = (count - c["next"]) % c["counts"] if c["known"] != 0 else 0
    restarted = False
    if missing >= c["counts"] // 2:
        c["in_a_row"] = c["in_a_row"] + 1 if count == c["next_of_past"] else 1
        c["next_of_past"] = after
        if c["in_a_row"] <= _RESTARTED_AFTER:
            if count == c["last"]:
                c["doubled"] += 1
            else:
                c["late"] += 1
            return OLD
        c["restarts"] += 1
        missing, restarted = 0, True
    c["known"], c["last"], c["next"], c["in_a_row"] = 1, count, after, 0
    c["lost"] += missing
    return RESTARTED if restarted else missing
