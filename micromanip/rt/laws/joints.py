"""Joints that swing at another frequency than was said: found from the phase of the predictor's own oscillations.

The states ``o = (o1, o2)`` of one, o2 its rate over its configured frequency, are ``A (sin th, cos th)``, and th grows
by that frequency and `detuning` (rad/s). A sample's correction ``d = gain * innovation`` moves th by

    lead = (o2 d1 - o1 d2) / |o|^2

and where the frequency is another one, every correction moves it the same way: `detuning` takes up `detuning_pull`
(1/s) of that, within a range and no faster than its slew. With b the share of the oscillation's error that a sample
removes, and g that of the lead, over the time between samples, that is taken up, it is the loop of ``tooth.py``. The
states are amplitude and phase, whatever the frequency: no position steps where it changes, and the gains stay.

Below `swing_floor_um2`, the square of an amplitude, nothing swings that could be followed, and `detuning` stays.
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


@compiled.rare
def follow_joints(
    p: Record, gain: Any, pull: Any, floor_um2: Any, detunings: Any, expected: Any, innovation_um: float
) -> None:
    """Take up a sample: a predictor's states were `expected` before its `gain` times the innovation corrected them.

    `pull`, `floor_um2` and `detunings` (modes,) are that predictor's.
    """
    for k in range(p["modes"]):
        if p["detuning_high"][k] > 0.0:
            i, omega, slew = 3 + 2 * k, p["oscillator"][k], p["detuning_slew"][k]
            o1, o2 = expected[i], expected[i + 1] / omega
            square = o1 * o1 + o2 * o2
            if square > floor_um2[k]:
                lead = innovation_um * (o2 * gain[i] - o1 * gain[i + 1] / omega) / square
                detuning = detunings[k] + max(-slew, min(slew, pull[k] * lead))
                detunings[k] = max(p["detuning_low"][k], min(p["detuning_high"][k], detuning))


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
    """Carry what was found over to other parameters: the frequency within the new range, amplitude and phase."""
    for k in range(MAX_MODES):
        if k < min(old["modes"], new["modes"]):
            before, after = old["oscillator"][k], new["oscillator"][k]
            found = before + s["detuning"][k]
            s["detuning"][k] = max(new["detuning_low"][k], min(new["detuning_high"][k], found - after))
            s["filtered"][4 + 2 * k] *= (found / before) * (after / (after + s["detuning"][k]))
        else:
            s["detuning"][k] = 0.0
