"""A learned correction of a path that repeats without a stop: played round and round, and changed in passing.

Repetitive control by a memory outside the loop: the correction of one period (`learned.py`) is played in cycle c as its
row ``(c - begun) mod rows``. What is learned meanwhile comes in the other half of the samples (``first``), and when
the period really began as another ``begun_cycle``. Both are taken over at the end of a period, old and new together as

    (1 - m) old + m new,     m minimum jerk from 0 to 1,

and old is played on meanwhile as if it had not ended. A period's own end is none: its last row is followed by its
first. The correction begins with a period, never with one that was broken off, and ends with the part at once.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record

from .learned import BROKEN_OFF, FINISHED, OTHER_TOOL, PATH_LEFT, PLAYS, WITHDRAWN
from .minimum_jerk import minimum_jerk
from .motion import position


@compiled
def _row(p: Record, samples: Any, first: int, k: int) -> float:
    """Correction (um) of row `k` of any period, within its limit."""
    value = samples[first + k % p["rows"], p["column"]]
    return max(-p["limit_um"], min(p["limit_um"], value))


@compiled
def _played(p: Record, s: Record, samples: Any, cycle: int, level: float, changed: float) -> float:
    """Correction (um) of `cycle`, of which `changed` (0 to 1) is what was taken over last."""
    value = _row(p, samples, s["first"], cycle - s["begun_cycle"])
    if changed < 1.0:
        old = _row(p, samples, s["old_first"], cycle - s["old_begun_cycle"])
        value = old + minimum_jerk(changed) * (value - old)
    return minimum_jerk(level) * value


@compiled
def _begin(p: Record, s: Record, cycle: int) -> None:
    """Begin with a period, once it is known of the part that runs when its periods do."""
    known = s["part_begun"] >= 0 and 0 <= p["begun_cycle"] and s["part_begun"] - p["begun_cycle"] <= p["search_cycles"]
    if not known or p["number"] == 0 or s["level"] > 0.0 or s["other_tool"] != 0:
        return
    into = (cycle - p["begun_cycle"]) % p["rows"]
    period = cycle - into
    if into <= p["latest_cycles"] and period - s["part"] > p["rows"] // 2:
        s["part"], s["begun_cycle"], s["number"], s["first"] = period, period, p["number"], p["first"]
        s["why"], s["changed"] = PLAYS, 1.0


@compiled
def _pass_end(p: Record, s: Record, cycle: int) -> None:
    """From one period to the next: with what there is now, and from when on it really begins."""
    rows = p["rows"]
    ended = (cycle - s["begun_cycle"]) // rows * rows
    if ended <= 0 or s["changed"] < 1.0:
        return
    begun = s["begun_cycle"] + ended
    late = (p["begun_cycle"] - begun + rows // 2) % rows - rows // 2
    if late != 0 or p["first"] != s["first"]:
        s["old_first"], s["old_begun_cycle"], s["changed"] = s["first"], begun, 0.0
    s["part"], s["begun_cycle"], s["number"], s["first"] = begun, begun + late, p["number"], p["first"]


@compiled
def _judge(p: Record, s: Record, w: Any, samples: Any, cycle: int, allowed: bool) -> int:
    """Whether the correction goes on in `cycle`, or why it ends."""
    if p["number"] == 0:
        return WITHDRAWN
    if s["other_tool"] != 0:
        return OTHER_TOOL
    if s["part_begun"] < 0 or s["part_begun"] > s["part"]:
        return FINISHED
    if not allowed:
        return BROKEN_OFF
    path = s["first"] + p["rows"] + (cycle - s["begun_cycle"]) % p["rows"]
    s["apart_um"] = abs(position(w) - samples[path, p["column"]])
    return PLAYS if s["apart_um"] <= p["tolerance_um"] else PATH_LEFT


@compiled
def add_periodic(p: Record, s: Record, w: Any, samples: Any, cycle: int, allowed: bool) -> None:
    """Add what is played in this cycle to the reference `w`: position, velocity and acceleration."""
    if s["why"] != PLAYS:
        _begin(p, s, cycle)
    if s["why"] == PLAYS:
        s["why"] = _judge(p, s, w, samples, cycle, allowed)
    if s["why"] == PLAYS:
        _pass_end(p, s, cycle)
    step, level, changed = 1.0 / p["fade_cycles"], s["level"], s["changed"]
    s["level"] = min(1.0, level + step) if s["why"] == PLAYS else max(0.0, level - step)
    s["changed"] = min(1.0, changed + step)
    if s["level"] == 0.0:
        return
    rise, change, rate = s["level"] - level, s["changed"] - changed, p["cycles_per_s"]
    now = _played(p, s, samples, cycle, s["level"], s["changed"])
    before = _played(p, s, samples, cycle - 1, level, changed)
    after = _played(p, s, samples, cycle + 1, s["level"] + rise, s["changed"] + change)
    s["played_um"] = now
    w[0] += now
    w[1] += 0.5 * rate * (after - before)
    w[2] += rate * rate * (after - 2.0 * now + before)
