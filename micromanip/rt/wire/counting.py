"""A device's counter: what is new, what is missing, what came twice or was overtaken, and whether it began anew."""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import record

COUNTED = record(
    ("counts", "i8"),
    ("known", "i8"),
    ("last", "i8"),
    ("past", "i8"),
    ("in_a_row", "i8"),
    ("lost", "i8"),
    ("doubled", "i8"),
    ("late", "i8"),
    ("restarts", "i8"),
)
"""A counter that wraps after `counts` (at most 2**32), where it stands, and what was counted since the start."""

OLD, RESTARTED = -1, -2
"""What ``missing_before`` returns for what is not fresh, and for the first of a device that has begun anew."""
_RESTARTED_AFTER = 3
"""So many in a row that go on from a count in the past: the device began anew, they were not overtaken."""


@compiled
def missing_before(c: Any, count: int) -> int:
    """How many are known to be missing before the one with this count; OLD, RESTARTED.

    A count that was there already is no news: device or network repeat themselves. One from the past, by less than half
    of the range, was overtaken on its way.
    """
    ahead = (count - c["last"]) % c["counts"]
    if c["known"] == 0:
        ahead = 1
    if ahead == 0 or ahead > c["counts"] // 2:
        if ahead == 0:
            c["doubled"] += 1
        else:
            c["late"] += 1
        c["in_a_row"] = c["in_a_row"] + 1 if count == (c["past"] + 1) % c["counts"] else 1
        c["past"] = count
        if c["in_a_row"] <= _RESTARTED_AFTER:
            return OLD
        c["restarts"] += 1
        c["last"], c["in_a_row"] = count, 0
        return RESTARTED
    c["known"], c["last"], c["in_a_row"] = 1, count, 0
    c["lost"] += ahead - 1
    return ahead - 1
