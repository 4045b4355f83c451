"""A learned correction: what earlier identical parts left over, played on top of the reference while a part runs.

The correction c (um) is a column of rows, one per cycle from the beginning of the part; position, speed and
acceleration of it are added to the reference's state, so that it goes through the same law, and the same limits of
set-point and voltage, as the reference itself. It never exceeds ``limit_um``. It begins with the part, ends after it
and is broken off as minimum jerk; a part that was broken off is not resumed.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

from .minimum_jerk import minimum_jerk

LEARNED_PARAMETERS = record(
    ("number", "i8"),
    ("rows", "i8"),
    ("column", "i8"),
    ("fade_cycles", "i8"),
    ("limit_um", "f8"),
    ("cycles_per_s", "f8"),
)
"""``rows`` 0 is none; ``number`` tells one part from the next: it begins with the cycle in which it changes."""
LEARNED_STATE = record(("number", "i8"), ("begun_cycle", "i8"), ("over", "i8"), ("level", "f8"))


@compiled
def _played(p: Record, samples: Any, k: int, level: float) -> float:
    """Correction (um) of cycle `k` of the part, within its limit; the first and the last row go on."""
    value = samples[max(0, min(p["rows"] - 1, k)), p["column"]]
    return minimum_jerk(level) * max(-p["limit_um"], min(p["limit_um"], value))


@compiled
def add_learned(p: Record, s: Record, w: Any, samples: Any, cycle: int, allowed: bool) -> None:
    """Add what is played in this cycle to the reference `w`: position, velocity and acceleration."""
    if s["number"] != p["number"]:
        s["number"], s["begun_cycle"], s["over"], s["level"] = p["number"], cycle, 0, 0.0
    k = cycle - s["begun_cycle"]
    if not allowed:
        s["over"] = 1
    step = 1.0 / p["fade_cycles"]
    ends = s["over"] != 0 or k >= p["rows"]
    level = s["level"]
    s["level"] = max(0.0, level - step) if ends else min(1.0, level + step)
    if ends and s["level"] == 0.0:
        s["over"] = 1
        return
    slope, rate = s["level"] - level, p["cycles_per_s"]
    before, after = _played(p, samples, k - 1, level), _played(p, samples, k + 1, s["level"] + slope)
    now = _played(p, samples, k, s["level"])
    w[0] += now
    w[1] += 0.5 * rate * (after - before)
    w[2] += rate * rate * (after - 2.0 * now + before)
