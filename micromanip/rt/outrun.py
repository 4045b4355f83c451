"""Which of its gains an axis acts by: near its path, or far from it and where little is seen.

A set-point that runs at its slew limit comes later than it is demanded, the more so the larger the error: after a
stall, a burst of missed cycles or a push of the tool, fast gains then swing the stage from end to end, whatever their
linear margins. So once their demand outruns the set-point, the calm ones (``control/gain_schedule.py``) act at once,
until the set-point has followed these for a while; then the fast ones are faded in from where it is. Gains that run
away again and again as soon as they are back are wrong: X-216.

Where many cycles or samples are missing one after the other, a loop acts on what is no more, in steps that it was not
made for: the fast gains of the strain loop then swing by themselves, those of the outer loop with them. So the calm
ones of both, the outer loop's and the PID's fallback gains, act as soon as more than `UNSEEN` cycles were missing
lately, before anything has outrun anything; and the PID's also while the outer loop's do.
"""

from __future__ import annotations

from .jit import compiled
from .record import Record

BEHIND, FAR, RELAPSED = 8.0, 200, 100
"""Cycles of slewing by which a demand is ahead of the set-point when it outruns it; cycles in which the calm gains must
be followed; cycles after that in which another outrun is a relapse."""
UNSEEN, AT_ONCE, REMEMBERED = 24.0, 12, 200
"""Missing cycles that are many, how many of one gap count, and for how many cycles they are remembered: one gap alone,
however long, is over when it is seen."""
_KEPT = 1.0 - 1.0 / REMEMBERED


@compiled
def forget_unseen(s: Record, missed: int) -> None:
    """A cycle that came `missed` cycles late: those before count less by now."""
    s["unseen"] = _KEPT * s["unseen"] + min(missed, AT_ONCE)


@compiled
def saw_late(s: Record, cycles: int) -> None:
    """A sample of the gauge that came `cycles` later than twice its interval; 0 or less: it was in time."""
    if cycles > 0:
        s["unseen"] += min(cycles, AT_ONCE)


@compiled
def is_disturbed(s: Record) -> bool:
    """Whether many cycles or samples were missing lately."""
    return s["unseen"] > UNSEEN


@compiled
def attainable(p: Record, s: Record, demand_um: float) -> float:
    """A demand (um) inside the set-point's range; where the set-point is outside, as at rest, up to there."""
    low, high = min(p["setpoint_low_um"], s["setpoint_um"]), max(p["setpoint_high_um"], s["setpoint_um"])
    return max(low, min(high, demand_um))


@compiled
def outruns(p: Record, s: Record, demand_um: float) -> bool:
    """Whether the set-point is far behind a demand, as far as its range goes."""
    return abs(attainable(p, s, demand_um) - s["setpoint_um"]) > BEHIND * p["setpoint_slew_um"]


@compiled
def leave_path(p: Record, s: Record, cycle: int, near_um: float) -> None:
    """Change to the calm gains where `near_um`, what the fast ones demand, outruns the set-point; count relapses."""
    s["near"] += 1
    if not outruns(p, s, near_um):
        return
    if s["relapses"] == 0 or s["near"] > RELAPSED:
        s["relapses"], s["relapsed_cycle"] = 0, cycle
    s["relapses"] += 1
    s["far"] = FAR


@compiled
def come_back(p: Record, s: Record, far_um: float) -> None:
    """Change back to the fast gains once `far_um`, what the calm ones demand, has been followed for a while."""
    s["far"] = FAR if outruns(p, s, far_um) else s["far"] - 1
    s["near"] = 0
