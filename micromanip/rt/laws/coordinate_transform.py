"""The tracker's own coordinates turned into axes: signals of the process image that are computed, not read.

    deviation_i = sum_j matrix[i, j] signal_j + offset_i

A derived signal is fresh when every source has been fresh since it was last; its time is that of the oldest source,
its status all of theirs together. The derived signals stand in the image after the drivers' inputs.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import MAX_AXES, Record, record

MAX_FRAME = 6
"""Coordinates that a tracker may have."""
FRAME = record(
    ("sources", "i8"),
    ("source", "i8", (MAX_FRAME,)),
    ("derived", "i8"),
    ("first", "i8"),
    ("matrix", "f8", (MAX_AXES, MAX_FRAME)),
    ("offset", "f8", (MAX_AXES,)),
)
"""Derived signals: places of their sources in the image, their number, their first place."""


@compiled
def derive_signals(p: Record, s: Record, signals: Any) -> None:
    """Compute the derived signals after an exchange; without a frame there are none."""
    frame = p["frame"]
    sources = frame["sources"]
    for j in range(sources):
        if signals[frame["source"][j]]["sequence"] == s["frame_sequence"][j]:
            return
    if sources == 0:
        return
    status, time_ns = 0, signals[frame["source"][0]]["time_ns"]
    for j in range(sources):
        source = signals[frame["source"][j]]
        status |= source["status"]
        time_ns = min(time_ns, source["time_ns"])
        s["frame_sequence"][j] = source["sequence"]
    for i in range(frame["derived"]):
        value = frame["offset"][i]
        for j in range(sources):
            value += frame["matrix"][i, j] * signals[frame["source"][j]]["value"]
        derived = signals[frame["first"] + i]
        derived["value"], derived["time_ns"], derived["status"] = value, time_ns, status
        derived["sequence"] += 1
