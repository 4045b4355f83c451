"""What came for one output of a device that compiled code serves: ``amplifier.Arrived`` in numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from micromanip.rt.record import record

from .amplifier import Arrived
from .compiled import compiled

ARRIVED = record(("samples", "i8"), ("minimum", "f8"), ("maximum", "f8"), ("largest_step", "f8"), ("last", "f8"))


@compiled
def note(a: Any, value: float) -> None:
    """One more command for an output."""
    if a["samples"] == 0:
        a["minimum"] = a["maximum"] = value
    a["minimum"], a["maximum"] = min(a["minimum"], value), max(a["maximum"], value)
    if math.isfinite(a["last"]):
        a["largest_step"] = max(a["largest_step"], abs(value - a["last"]))
    a["last"] = value
    a["samples"] += 1


def gathered(names: Sequence[str | None], records: Any) -> Iterator[tuple[str, Arrived]]:
    """What has come for each output since the last time, of those that have a name; the records begin anew."""
    for name, a in zip(names, records, strict=False):
        if name is not None and a["samples"] > 0:
            low, high, step = float(a["minimum"]), float(a["maximum"]), float(a["largest_step"])
            yield name, Arrived(low, high, step, int(a["samples"]), float(a["last"]))
            a["samples"], a["largest_step"] = 0, 0.0
