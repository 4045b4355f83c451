"""Phase-locked loop: finds an oscillator's true frequency from the phase of its own corrections.

Its states ``o = (o1, o2)`` are ``A (sin th, cos th)``; th grows by the configured frequency plus the detuning found. A
sample's correction ``d`` of the states moves th by

    lead = (o2 d1 - o1 d2) / |o|^2

and if the frequency differs, every correction moves th in the same direction: the detuning integrates a share of this,
within a range and a slew limit. With b the share of the oscillator's error that a sample removes and g the share of the
lead that is taken up, the linearised loop is ``z^2 - (2 - b) z + 1 - b + b g``: a phase-locked loop whose filter is the
Kalman gain (Gardner, Phaselock Techniques, chapter 2) and has a damping of ``sqrt(b / g) / 2``. Far from the frequency
the oscillator is dragged around at the difference, so that the lead shows it without a lock.

Joints: each of the predictor's oscillations has its lock. Its o2 is the rate over the configured frequency; `detuning`
(rad/s) integrates a sample's lead by `detuning_pull` (1/s). The states are amplitude and phase at any frequency, so no
position jumps when it changes, and the gains stay. Below `swing_floor_um2`, the square of an amplitude, there is no
oscillation to follow, and `detuning` stays.

Tooth passing: the lock finds the `turn` (rad) beyond the configured angle by which the estimator's oscillator turns per
cycle, within a range about 0. Below `tooth_floor_um2` `turn` stays. The oscillator is dropped, until the filter starts
anew, if windows of samples show that it does no good:

- in one of them the frequency stood at an end of its range, by a hundredth of it, in 90 % of the samples;
- in `tooth_patience` of them, one after the other, the innovations e were worse with the tooth than without: so many as
  an oscillator takes to forget a tooth that has left the cut. Without its states, which show in them as
  ``s = shown . o``, they would be e + s. Over the window the sum of ``(e + s)^2 - e^2 = 2 e s + s^2`` is compared
  with the spread of its noise, ``V^2 = sum (2 e s)^2``. s is known before e, so where e is symmetric about zero, given
  what was before, the sum falls below -x V in one of ``exp(x^2 / 2)`` windows at most (de la Pena, A general class of
  exponential inequalities for martingales and ratios, 1999). x is 7: one of 4e10. Innovations of a real loop have a
  colour, which shows where there is no tooth and s is next to nothing: so they must be worse by a tenth as well.

Then the states fade, and the gains are those of the filter without them: no number steps.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record

MAX_MODES = 3
_TURN = 2.0 * math.pi
JOINTS: tuple[Field, ...] = (
    ("detuning_low", "f8", (MAX_MODES,)),
    ("detuning_high", "f8", (MAX_MODES,)),
    ("detuning_pull", "f8", (MAX_MODES,)),
    ("detuning_slew", "f8", (MAX_MODES,)),
    ("swing_floor_um2", "f8", (MAX_MODES,)),
)
"""Low and high end of the range in rad/s, 0: the frequency is the configured one; slew in rad/s a sample."""
JOINTS_STATE: tuple[Field, ...] = (("detuning", "f8", (MAX_MODES,)),)
TOOTH: tuple[Field, ...] = (
    ("tooth", "i8"),
    ("tooth_share", "f8"),
    ("tooth_turn", "f8"),
    ("tooth_range", "f8"),
    ("tooth_slew", "f8"),
    ("tooth_floor_um2", "f8"),
    ("tooth_shown", "f8", (2,)),
    ("tooth_window", "i8"),
    ("tooth_patience", "i8"),
    ("tooth_fade", "f8"),
)
"""``tooth``: place of the first of the oscillator's two states, 0: nothing is followed. ``tooth_turn``: the configured
angle, ``tooth_range`` how far it may be off, both rad a cycle; ``tooth_slew`` of that, a sample; ``tooth_share`` of the
lead, per cycle; ``tooth_window``: samples, ``tooth_patience``: windows; ``tooth_fade``: what is left of the states a
cycle after."""
TOOTH_STATE: tuple[Field, ...] = (
    ("turn", "f8"),
    ("given_up", "i8"),
    ("tooth_samples", "i8"),
    ("tooth_at_end", "i8"),
    ("tooth_worse", "i8"),
    ("tooth_gained_um2", "f8"),
    ("tooth_spread_um4", "f8"),
    ("tooth_square_um2", "f8"),
)
FOLLOWS, AT_END, NO_GAIN = range(3)
"""``given_up``: not; the frequency stood at an end of its range; the innovations were no better with the tooth."""

_AT_END, _AT_END_SHARE = 0.99, 0.9
"""At an end of its range is who is beyond so much of it, as the noise of a wide observer moves it; share of samples."""
_SIGMAS_SQUARED = 49.0
_WORSE = 0.1
_GONE_UM2 = 1e-12


@compiled
def locked(
    found: float, o1: float, o2: float, d1: float, d2: float, share: float, slew: float, low: float, high: float
) -> float:
    """What is `found` after a correction (d1, d2) of the states (o1, o2), which are not both 0."""
    step = share * (o2 * d1 - o1 * d2) / (o1 * o1 + o2 * o2)
    return max(low, min(high, found + max(-slew, min(slew, step))))


@compiled.rare
def follow_joints(
    p: Record, gain: Any, pull: Any, floor_um2: Any, detunings: Any, expected: Any, innovation_um: float
) -> None:
    """Process a sample: a predictor's states were `expected` before `gain` times the innovation corrected them.

    `pull`, `floor_um2` and `detunings` (modes,) are that predictor's.
    """
    for k in range(p["modes"]):
        if p["detuning_high"][k] > 0.0:
            i, omega, slew = 3 + 2 * k, p["oscillator"][k], p["detuning_slew"][k]
            o1, o2 = expected[i], expected[i + 1] / omega
            if o1 * o1 + o2 * o2 > floor_um2[k]:
                d1, d2 = gain[i] * innovation_um, gain[i + 1] / omega * innovation_um
                low, high = p["detuning_low"][k], p["detuning_high"][k]
                detunings[k] = locked(detunings[k], o1, o2, d1, d2, pull[k], slew, low, high)


@compiled
def as_rates(p: Record, s: Record, w: Any) -> None:
    """Turn `w`, in which something swings at another frequency, into what gains for the configured one need.

    The second state becomes the rate. What the oscillation is accelerated by beyond the configured one is the path's.
    """
    for k in range(p["modes"]):
        if s["detuning"][k] != 0.0:
            i, omega = 3 + 2 * k, p["oscillator"][k]
            found = omega + s["detuning"][k]
            w[2] -= (found * found - omega * omega) * w[i]
            w[i + 1] *= found / omega


@compiled
def joint_Hz(p: Record, s: Record, k: int) -> float:
    """The frequency that oscillation `k` has found, or found last; NaN where none is looked for."""
    if k >= p["modes"] or not p["detuning_high"][k] > 0.0:
        return math.nan
    return (p["oscillator"][k] + s["detuning"][k]) / _TURN


@compiled.rare
def keep_detuning(old: Record, new: Record, s: Record) -> None:
    """Carry the found frequency over to new parameters: within the new range, with amplitude and phase kept."""
    for k in range(MAX_MODES):
        if k < min(old["modes"], new["modes"]):
            before, after = old["oscillator"][k], new["oscillator"][k]
            found = before + s["detuning"][k]
            s["detuning"][k] = max(new["detuning_low"][k], min(new["detuning_high"][k], found - after))
            s["filtered"][4 + 2 * k] *= (found / before) * (after / (after + s["detuning"][k]))
        else:
            s["detuning"][k] = 0.0


@compiled
def start_tooth(s: Record) -> None:
    """The configured frequency, nothing seen yet."""
    s["turn"] = 0.0
    s["given_up"] = FOLLOWS
    s["tooth_worse"] = 0
    _begin_window(s)


@compiled
def turn_on(p: Record, s: Record, x: Any) -> None:
    """Turn the oscillator in `x` by one cycle beyond its model, or fade it once it is dropped."""
    i, turn = p["tooth"], s["turn"]
    square = turn * turn
    cos, sin = 1.0 - square * (0.5 - square / 24.0), turn * (1.0 - square / 6.0)
    if s["given_up"] != FOLLOWS:
        cos, sin = cos * p["tooth_fade"], sin * p["tooth_fade"]
    x[i], x[i + 1] = cos * x[i] + sin * x[i + 1], cos * x[i + 1] - sin * x[i]


@compiled
def follow_tooth(p: Record, s: Record, o1: float, o2: float, d1: float, d2: float, applied_um: float) -> None:
    """Process a sample: the oscillator was (o1, o2) before its correction (d1, d2), the innovation `applied_um`."""
    shown_um = p["tooth_shown"][0] * o1 + p["tooth_shown"][1] * o2
    noise = 2.0 * applied_um * shown_um
    s["tooth_gained_um2"] += noise + shown_um * shown_um
    s["tooth_spread_um4"] += noise * noise
    s["tooth_square_um2"] += applied_um * applied_um
    if o1 * o1 + o2 * o2 > p["tooth_floor_um2"]:
        share, slew, most = p["tooth_share"], p["tooth_slew"], p["tooth_range"]
        s["turn"] = locked(s["turn"], o1, o2, d1, d2, share, slew, -most, most)
        s["tooth_at_end"] += 1 if abs(s["turn"]) >= _AT_END * most else 0
    s["tooth_samples"] += 1
    if s["tooth_samples"] >= p["tooth_window"]:
        lost_um2 = -s["tooth_gained_um2"]
        certain = lost_um2 * lost_um2 > _SIGMAS_SQUARED * s["tooth_spread_um4"]
        if s["tooth_at_end"] > _AT_END_SHARE * s["tooth_samples"]:
            s["given_up"] = AT_END
        worse = lost_um2 > _WORSE * s["tooth_square_um2"] and certain
        s["tooth_worse"] = s["tooth_worse"] + 1 if worse else 0
        if s["tooth_worse"] >= p["tooth_patience"]:
            s["given_up"] = NO_GAIN
        _begin_window(s)


@compiled
def tooth_Hz(p: Record, s: Record, cycles_per_ns: float) -> float:
    """The frequency that was found; NaN where none is looked for."""
    return (p["tooth_turn"] + s["turn"]) * cycles_per_ns * 1e9 / _TURN if p["tooth"] > 0 else math.nan


@compiled
def forget_tooth(p: Record, x: Any) -> None:
    """Set faded states to zero: denormal numbers would be slow to compute with."""
    i = p["tooth"]
    if x[i] * x[i] + x[i + 1] * x[i + 1] < _GONE_UM2:
        x[i] = x[i + 1] = 0.0


@compiled
def _begin_window(s: Record) -> None:
    s["tooth_samples"] = s["tooth_at_end"] = 0
    s["tooth_gained_um2"] = s["tooth_spread_um4"] = s["tooth_square_um2"] = 0.0
