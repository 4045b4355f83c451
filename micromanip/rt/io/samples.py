"""The numbers of a frame as samples for the loop: which are fresh, how old, and whether they are to be trusted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.rt.jit import compiled
from micromanip.rt.record import record
from micromanip.rt.records import MAX_SIGNALS

from .codec import BAD_STATUS, code_of, status_of, value_of
from .frames import MAX_GROUPS

SAMPLES = record(
    ("group_count", "i8", (MAX_GROUPS,)),
    ("group_known", "i8", (MAX_GROUPS,)),
    ("missing", "i8", (MAX_GROUPS,)),
    ("lost", "i8", (MAX_SIGNALS,)),
)
"""Where the counter of each group stands. ``missing`` is scratch: samples of each group that are missing before the one
that has come, -1 for none. ``lost`` are those of each number that never came, since the start."""


@compiled
def leave_samples(
    s: Any, f: Any, data: Any, inputs: Any, lost: Any, missing: int, time_ns: int, passed: int = 0
) -> None:
    """The values of a fresh frame of `time_ns`, `missing` after the one before, as samples.

    Group 0 has `passed` more before this one, which came with it and which nobody needs. What never came is added to
    `lost` of each number.
    """
    for g in range(f["groups"]):
        s["missing"][g] = missing if g == 0 else missing_of_group(s, f, g, data)
    status = status_of(f, data)
    for i in range(f["numbers"]):
        g = f["group_of"][i]
        if s["missing"][g] < 0:
            continue
        value = value_of(f, f["number"][i], data)
        signal = inputs[i]
        signal["value"], signal["time_ns"] = value, time_ns - f["group"][g]["latency_ns"]
        signal["status"] = status if math.isfinite(value) or status != 0 else BAD_STATUS
        signal["sequence"] += 1 + s["missing"][g] + (passed if g == 0 else 0)
        lost[i] += s["missing"][g]


@compiled
def missing_of_group(s: Any, f: Any, g: int, data: Any) -> int:
    """Samples missing before the one that the frame brings of a slower group; -1 where it brings none."""
    n = f["group"][g]["counter"]
    count = np.int64(code_of(n, data))
    ahead = (count - s["group_count"][g]) % (1 << n["bits"])
    known = s["group_known"][g] != 0
    s["group_count"][g], s["group_known"][g] = count, 1
    return ahead - 1 if known else 0
