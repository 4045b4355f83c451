"""Schedules the gains of an axis and suspends parts of its law, with the reasons: once a cycle, before the laws.

The manual explains each reason (``docs/architecture.md``).

A slew limit delays the set-point more the larger the error is. After a stall, a burst of missed cycles or a push of the
tool, nominal gains then swing the stage from end to end, in spite of their linear margins. So when their demand is
ahead of the set-point, calm gains (``control/gain_schedule.py``) act at once, until the set-point has followed their
demand for a while; then the nominal gains are faded in from the present set-point. If the nominal gains run ahead again
and again as soon as they are back, they are wrong: X-216.

If many cycles or samples are missing, a loop acts on stale data with longer steps than designed, and nominal gains may
cause a limit cycle. A cycle in which the device is behind counts as missing.
"""

from __future__ import annotations

from micromanip.rt.laws.lqg import outer_setpoint
from micromanip.rt.laws.pid import retune
from micromanip.rt.laws.saturation import attainable

from .jit import compiled
from .record import Record, record
from .states import CLOSED, COASTING, DEGRADED, DRIVEN, EVENT_CODES, FALLBACK, OUTRUN

DEMAND_AHEAD, SWINGING, GAUGE_LOST, STAGE_LOST = 1 << OUTRUN, 1 << FALLBACK, 1 << COASTING, 1 << DEGRADED
MISSING, DEVICE_BEHIND = 1 << EVENT_CODES, 2 << EVENT_CODES
FOUND = SWINGING | GAUGE_LOST | STAGE_LOST
"""Bits of the conditions that the watch has found."""
OUTER_CALM = DEMAND_AHEAD | MISSING
INNER_CALM = OUTER_CALM | SWINGING
INNER_WAITS = GAUGE_LOST | DEVICE_BEHIND
UNSTEADY = DEMAND_AHEAD | SWINGING | GAUGE_LOST | STAGE_LOST

BEHIND, FOLLOWED, RELAPSED = 8.0, 200, 100
"""Cycles of slewing by which a demand is ahead of the set-point when it outruns it; cycles in which the calm gains must
be followed; cycles after that in which another outrun is a relapse."""
MANY, AT_ONCE, REMEMBERED = 24.0, 12, 200
"""Missing cycles that are many, how many of one gap count, and for how many cycles they are remembered: one gap alone,
however long, is over when it is seen."""
_KEPT = 1.0 - 1.0 / REMEMBERED

SUPERVISOR_STATE = record(
    ("reasons", "i8"),
    ("missing", "f8"),
    ("passed", "i8"),
    ("step", "i8"),
    ("gain_set", "i8"),
    ("calm_left", "i8"),
    ("nominal_cycles", "i8"),
    ("relapses", "i8"),
    ("relapsed_cycle", "i8"),
)
"""The reasons of this cycle; missing cycles as they are remembered; cycles since the PID's last step, or since it last
waited; those that the step of this cycle covers, 0 where it makes none; its gains (1: calm); for how many cycles calm
gains of the outer loop are still to be followed; for how many the nominal ones have acted; how often, and since when,
these have run away."""


@compiled
def start_supervisor(s: Record) -> None:
    """The axis begins with its nominal gains."""
    s["gain_set"] = s["calm_left"] = s["nominal_cycles"] = s["relapses"] = s["passed"] = 0
    s["missing"] = 0.0


@compiled
def supervise(p: Record, s: Record, order: Record) -> None:
    """Count what is missing; note the reasons of this cycle, and whether the PID makes a step in it."""
    u, reasons = s["supervisor"], order["reasons"] | (DEVICE_BEHIND if order["behind"] != 0 else 0)
    idle = p["feedback"] == 0 or order["phase"] not in DRIVEN
    waits = idle or reasons & INNER_WAITS != 0
    late = int(not idle and 0 < abs(order["behind"]) <= AT_ONCE)  # of one wait the first cycles count, as of any gap
    u["passed"] += 1
    u["step"] = u["passed"] if s["strain"]["fresh"] != 0 and not waits else 0
    if u["step"] > 0:
        late = max(0, min(u["step"] - p["pid"]["most_periods"], AT_ONCE))
    if waits or u["step"] > 0:
        u["passed"] = 0
    u["missing"] = _KEPT * u["missing"] + min(order["missed"], AT_ONCE) + late
    reasons |= MISSING if u["missing"] > MANY else 0
    u["reasons"] = reasons | (DEMAND_AHEAD if u["calm_left"] > 0 else 0)


@compiled
def is_steady(s: Record, order: Record) -> bool:
    """Whether the axis tracks or is held, with both sensors and its nominal gains."""
    steady = order["phase"] == CLOSED and (order["level"] == 0.0 or order["level"] == 1.0)
    return steady and s["supervisor"]["reasons"] & UNSTEADY == 0


@compiled
def inner_gains(p: Record, s: Record) -> Record:
    """Gains of the PID's step in this cycle; a change of gains is bumpless."""
    u = s["supervisor"]
    calm = int(u["reasons"] & INNER_CALM != 0)
    if calm != u["gain_set"]:
        retune(gains_of(p, u["gain_set"]), gains_of(p, calm), s["pid"])
        u["gain_set"] = calm
    return gains_of(p, calm)


@compiled
def gains_of(p: Record, gain_set: int) -> Record:
    """The PID's nominal gains (0), or the calm ones (1)."""
    return p["fallback"] if gain_set != 0 else p["pid"]


@compiled
def outruns(p: Record, s: Record, demand_um: float) -> bool:
    """Whether the set-point is far behind a demand, as far as its range goes."""
    inside_um = attainable(p["setpoint_low_um"], p["setpoint_high_um"], s["setpoint_um"], demand_um)
    return abs(inside_um - s["setpoint_um"]) > BEHIND * p["setpoint_slew_um"]


@compiled
def outer_demand(p: Record, s: Record, anew: bool) -> float:
    """Set-point (um) that the outer loop demands, by the gains that act.

    If it begins `anew`, or with nominal gains again, it starts at the present set-point: ``bridge_um`` fades.
    """
    outer, x, w, u = p["outer"], s["estimator"]["x"], s["reference"]["w"], s["supervisor"]
    rest = p["centre_um"] + s["added_um"]
    nominal_um = rest + outer_setpoint(outer, outer["feedback"], outer["reference"], x, w)
    if anew:
        s["outer"]["bridge_um"] = s["setpoint_um"] - nominal_um
    s["outer"]["bridge_um"] *= p["blend_decay"]
    if u["reasons"] & MISSING != 0:
        u["calm_left"] = FOLLOWED
    elif u["calm_left"] == 0:
        u["nominal_cycles"] += 1
        if not outruns(p, s, nominal_um + s["outer"]["bridge_um"]):
            return nominal_um + s["outer"]["bridge_um"]
        if u["relapses"] == 0 or u["nominal_cycles"] > RELAPSED:
            u["relapses"], u["relapsed_cycle"] = 0, s["estimator"]["cycle"]
        u["relapses"] += 1
        u["calm_left"] = FOLLOWED
    s["outer"]["bridge_um"] = s["setpoint_um"] - nominal_um
    return calm_demand(p, s, rest)


@compiled.rare
def calm_demand(p: Record, s: Record, rest: float) -> float:
    """The same by the calm gains, until the set-point has followed them for a while."""
    outer, x, w, u = p["outer"], s["estimator"]["x"], s["reference"]["w"], s["supervisor"]
    calm_um = rest + outer_setpoint(outer, outer["far_feedback"], outer["far_reference"], x, w)
    u["calm_left"] = FOLLOWED if outruns(p, s, calm_um) else u["calm_left"] - 1
    u["nominal_cycles"] = 0
    u["reasons"] = u["reasons"] | DEMAND_AHEAD if u["calm_left"] > 0 else u["reasons"] & ~DEMAND_AHEAD
    return calm_um
