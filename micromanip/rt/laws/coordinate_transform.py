"""Coupling between axes: the tracker's coordinates transformed into those of the axes, and decoupling.

    deviation_i = sum_j matrix[i, j] signal_j + offset_i

are signals of the process image that are computed, not read. A derived signal is fresh when every source has had a
fresh sample since its last value; its time is that of the oldest source, its status combines all of theirs. In the
image the derived signals follow the drivers' inputs.

Decoupling: a stage sees a share c_ij of axis j's motion. Its own sensor sees it too, so the outer loop rejects it, but
only as fast as any other disturbance. The motion of the others is known ahead by their references r_j. So the set-point
is

    u_i = .. - sum_j c_ij / g_i (r_j + lead_i r_j')

with the steady gain g_i of the stage, and the lead that compensates its lag at low frequencies. This is feedforward: it
closes no loop, and no margin changes. The estimator does not get this part, because it cancels the coupling, which the
estimator does not model.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import MAX_AXES, Record, record

from .frequency_lock import MAX_MODES
from .predictor import position

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
DECOUPLING_PARAMETERS = record(("active", "i8"), ("lead_s", "f8"), ("share", "f8", (MAX_AXES,)))
"""``share``: c_ij / g_i by axis; ``active`` 0: there is none."""


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


@compiled
def owed_um(p: Record, j: int, w: Any) -> float:
    """What the reference `w` of axis `j`, as last followed, adds to the set-point."""
    speed = w[1]
    for k in range(MAX_MODES):
        speed += w[4 + 2 * k]
    return -p["share"][j] * (position(w) + p["lead_s"] * speed)
