"""Joints that swing at another frequency than was said: each of the predictor's oscillations has its lock.

Of ``frequency_lock.py`` o2 is the oscillation's rate over its configured frequency, and `detuning` (rad/s) what was
found beyond that, of which a sample's lead, by `detuning_pull` (1/s), is taken up. The states are amplitude and phase,
whatever the frequency: no position steps where it changes, and the gains stay.

Below `swing_floor_um2`, the square of an amplitude, nothing swings that could be followed, and `detuning` stays.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record

from .frequency_lock import locked

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
    """Carry what was found over to other parameters: the frequency within the new range, amplitude and phase."""
    for k in range(MAX_MODES):
        if k < min(old["modes"], new["modes"]):
            before, after = old["oscillator"][k], new["oscillator"][k]
            found = before + s["detuning"][k]
            s["detuning"][k] = max(new["detuning_low"][k], min(new["detuning_high"][k], found - after))
            s["filtered"][4 + 2 * k] *= (found / before) * (after / (after + s["detuning"][k]))
        else:
            s["detuning"][k] = 0.0
