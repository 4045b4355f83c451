"""A small multisine on top of the set-point, to measure the sensitivity of the loops.

    d[k] = l(k) sum_i a_i cos(2 pi (h_i k mod N) / N + phi_i)

k cycles after its beginning, N the period of the whole, h_i whole numbers: each line is one of an FFT over N cycles,
and a cycle that was missed shifts nothing. The level l rises and falls as minimum jerk: it begins and ends at zero
without a step. It is added to the actuator's set-point (um), before its limits. This is the input of the outer loop's
plant, and the reference of the strain loop, whose voltage follows it at low frequencies. If it were added to the
voltage, feedback would remove it just there, and leave hysteresis and noise.

A stop fades the level out; an axis that is no longer ``CLOSED`` has no excitation, and plays that number no more.
"""

from __future__ import annotations

import math

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

from .move import minimum_jerk

MAX_LINES = 96

EXCITATION_PARAMETERS = record(
    ("number", "i8"),
    ("stop", "i8"),
    ("cycles", "i8"),
    ("fade_cycles", "i8"),
    ("period_cycles", "i8"),
    ("lines", "i8"),
    ("harmonic", "i8", (MAX_LINES,)),
    ("amplitude", "f8", (MAX_LINES,)),
    ("phase", "f8", (MAX_LINES,)),
)
"""``lines`` 0 is none; amplitudes in um; ``cycles`` with both fades; ``number`` tells one from the next."""
EXCITATION_STATE = record(("number", "i8"), ("begun_cycle", "i8"), ("over", "i8"), ("level", "f8"))


@compiled.rare
def excitation(p: Record, s: Record, cycle: int, allowed: bool) -> float:
    """Offset of this cycle, um; 0 without an excitation."""
    if p["lines"] == 0:
        return 0.0
    if s["number"] != p["number"]:
        s["number"], s["begun_cycle"], s["over"], s["level"] = p["number"], cycle, 0, 0.0
    k = cycle - s["begun_cycle"]
    if not allowed or s["over"] != 0:
        s["over"], s["level"] = 1, 0.0
        return 0.0
    step = 1.0 / p["fade_cycles"]
    ends = p["stop"] != 0 or k >= p["cycles"] - p["fade_cycles"]
    s["level"] = max(0.0, s["level"] - step) if ends else min(1.0, s["level"] + step)
    if ends and s["level"] == 0.0:
        s["over"] = 1
    total = 0.0
    for i in range(p["lines"]):
        turned = (p["harmonic"][i] * k) % p["period_cycles"]
        total += p["amplitude"][i] * math.cos(2.0 * math.pi * turned / p["period_cycles"] + p["phase"][i])
    return minimum_jerk(s["level"]) * total
