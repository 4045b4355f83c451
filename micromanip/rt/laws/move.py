"""A move of a held axis: its held position follows a course that was judged beforehand.

Either from place to place, each way as minimum jerk, with a rest at each, or an oscillation

    l(k) A sin(2 pi (f0 k + (f1 - f0) k^2 / (2 N)))

k cycles after its beginning, N its length, with a level l that rises and falls as minimum jerk: a sine where f0 = f1,
else a sweep. The time of the course advances with the cycles that run: a missed cycle delays it and causes no jump. A
stop slows this time until it stands: the axis comes to rest on its course, and is held there. The end of the hold ends
the move where it is; it never resumes by itself.
"""

from __future__ import annotations

import math

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

NO_MOVE, PLACES, OSCILLATION = range(3)
MAX_PLACES = 16

MOVE_PARAMETERS = record(
    ("number", "i8"),
    ("kind", "i8"),
    ("stop", "i8"),
    ("stop_cycles", "i8"),
    ("cycles", "i8"),
    ("fade_cycles", "i8"),
    ("amplitude_um", "f8"),
    ("first_per_cycle", "f8"),
    ("last_per_cycle", "f8"),
    ("places", "i8"),
    ("place_um", "f8", (MAX_PLACES,)),
    ("way_cycles", "i8", (MAX_PLACES,)),
    ("rest_cycles", "i8", (MAX_PLACES,)),
)
"""``number`` tells one move from the next; places in um from where it began; frequencies in turns per cycle."""
MOVE_STATE = record(
    ("number", "i8"),
    ("over", "i8"),
    ("begun_cycle", "i8"),
    ("passed", "f8"),
    ("pace", "f8"),
    ("offset_um", "f8"),
    ("speed_um", "f8"),
    ("acceleration_um", "f8"),
)
"""Speed and acceleration are per cycle."""


@compiled
def minimum_jerk(x: float) -> float:
    """Course of what the controller moves by itself: 0 to 1 for x in 0..1, at rest at both ends."""
    x = max(0.0, min(1.0, x))
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@compiled.rare
def course(p: Record, k: float) -> float:
    """Offset (um) from where the move began, `k` cycles of its own time after that."""
    if p["kind"] == OSCILLATION:
        fade = min(k, p["cycles"] - k) / p["fade_cycles"]
        sweep = (p["last_per_cycle"] - p["first_per_cycle"]) * k / (2.0 * p["cycles"])
        return p["amplitude_um"] * minimum_jerk(fade) * math.sin(2.0 * math.pi * k * (p["first_per_cycle"] + sweep))
    before = 0.0
    for i in range(p["places"]):
        if k < p["way_cycles"][i]:
            return before + (p["place_um"][i] - before) * minimum_jerk(k / p["way_cycles"][i])
        before = p["place_um"][i]
        k -= p["way_cycles"][i]
        if k < p["rest_cycles"][i]:
            return before
        k -= p["rest_cycles"][i]
    return before


@compiled
def advance_move(p: Record, s: Record, cycle: int, allowed: bool) -> None:
    """One cycle of the move: ``speed_um`` is by how much the axis is held elsewhere after it.

    It is `allowed` while the cell is held, nothing is wrong and the axis has its sensors and its own gains.
    """
    before = s["speed_um"]
    s["speed_um"] = s["acceleration_um"] = 0.0
    if s["number"] != p["number"]:
        s["number"], s["begun_cycle"], s["over"] = p["number"], cycle, 0
        s["passed"] = s["offset_um"] = before = 0.0
        s["pace"] = 1.0
    if p["kind"] == NO_MOVE or s["over"] != 0:
        return
    if not allowed:
        s["over"] = 1
        return
    if p["stop"] != 0:
        s["pace"] = max(0.0, s["pace"] - 1.0 / p["stop_cycles"])
    s["passed"] = min(float(p["cycles"]), s["passed"] + minimum_jerk(s["pace"]))
    offset = course(p, s["passed"])
    s["speed_um"] = offset - s["offset_um"]
    s["acceleration_um"] = s["speed_um"] - before
    s["offset_um"] = offset
    if s["pace"] == 0.0 or s["passed"] >= p["cycles"]:
        s["over"] = 1
