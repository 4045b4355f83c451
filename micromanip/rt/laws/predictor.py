"""Extrapolation of a reference, and a second, narrow predictor, weighted by its likelihood.

The state of a reference is ``w = [p, v, a, o1, o1', ..]``, extrapolated in closed form.

The wide predictor of ``reference.py`` tolerates changes: joints that jump, another pose. In steady conditions it passes
more noise than necessary. A narrow predictor runs beside it, with the same states and less process noise, whose path
may also return (`returning`, 1/s^2: the acceleration opposes the rate, so that the path swings slowly). The output is
the mean of both, weighted by likelihood (Magill, Optimal Adaptive Estimation of Sampled Stochastic Processes, IEEE
Transactions on Automatic Control, 1965),

    trust += (e_wide^2 - e_narrow^2) / (2 v),   given = wide + (narrow - wide) / (1 + exp(-trust))

e being the innovations and v the variance that the narrow one states for its own. The wide predictor does not depend on
the narrow one. `trust` (nats) is at most `SURE_NATS`, so that it can fall soon. After a sample further than `FAR_SIGMA`
from its expectation, or at a trust below `LOST_NATS`, the narrow predictor restarts at the wide one's state, with a
trust of `ANEW_NATS`.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record

from .frequency_lock import MAX_MODES, follow_joints

STATES = 3 + 2 * MAX_MODES
SURE_NATS, LOST_NATS, ANEW_NATS, FAR_SIGMA = 6.0, -18.0, -9.0, 6.0
NEVER_DOUBTED_UM2 = 1e12
"""In the place of ``steady_um2``: no sample changes the trust."""

STEADY: tuple[Field, ...] = (
    ("steady", "i8"),
    ("steady_gain", "f8", (STATES,)),
    ("steady_um2", "f8"),
    ("returning", "f8"),
    ("steady_pull", "f8", (MAX_MODES,)),
    ("steady_floor_um2", "f8", (MAX_MODES,)),
)
STEADY_STATE: tuple[Field, ...] = (
    ("wide", "f8", (STATES,)),
    ("narrow", "f8", (STATES,)),
    ("wide_detuning", "f8", (MAX_MODES,)),
    ("narrow_detuning", "f8", (MAX_MODES,)),
    ("trust", "f8"),
)


@compiled
def extrapolate(p: Record, detuning: Any, w: Any, tau_s: float, out: Any) -> None:
    """`out` = `w` after `tau_s` seconds: constant acceleration, and each oscillation turned and decayed.

    They turn at their configured frequencies and `detuning` (modes,) rad/s, in units of the configured ones. Of a
    decaying one the second state is not quite the rate of the first: both decay alike (Harvey, Forecasting, Structural
    Time Series Models and the Kalman Filter, section 2.3.3).
    """
    out[0] = w[0] + tau_s * (w[1] + 0.5 * tau_s * w[2])
    out[1] = w[1] + tau_s * w[2]
    out[2] = w[2]
    for k in range(p["modes"]):
        omega = p["oscillator"][k]
        angle = (omega + detuning[k]) * tau_s
        sine, cosine = math.sin(angle), math.cos(angle)
        if p["decay"][k] > 0.0:
            left = math.exp(-p["decay"][k] * tau_s)
            sine *= left
            cosine *= left
        o, o_dot = w[3 + 2 * k], w[4 + 2 * k]
        out[3 + 2 * k] = cosine * o + sine / omega * o_dot
        out[4 + 2 * k] = -omega * sine * o + cosine * o_dot


@compiled
def position(w: Any) -> float:
    """Where the reference is (um): the path and its oscillations; those that it has not are 0."""
    total = w[0]
    for k in range(MAX_MODES):
        total += w[3 + 2 * k]
    return total


@compiled.rare
def narrow_anew(s: Record) -> None:
    """Restart the narrow predictor at the wide one's state."""
    for i in range(STATES):
        s["narrow"][i] = s["wide"][i]
    for k in range(MAX_MODES):
        s["narrow_detuning"][k] = s["wide_detuning"][k]
    s["trust"] = ANEW_NATS


@compiled
def follow_narrowly(p: Record, s: Record, value_um: float, gap_s: float, innovation_um: float) -> None:
    """Correct with a sample `gap_s` after the last, whose innovation of the wide predictor was `innovation_um`."""
    narrow, expected = s["narrow"], s["w"]
    extrapolate(p, s["narrow_detuning"], narrow, gap_s, expected)
    expected[2] -= p["returning"] * gap_s * expected[1]
    own_um = value_um - position(expected)
    trust = s["trust"] + (innovation_um * innovation_um - own_um * own_um) / (2.0 * p["steady_um2"])
    if own_um * own_um <= FAR_SIGMA * FAR_SIGMA * p["steady_um2"] and trust > LOST_NATS:
        s["trust"] = min(SURE_NATS, trust)
        for i in range(STATES):
            narrow[i] = expected[i] + p["steady_gain"][i] * own_um
        follow_joints(
            p, p["steady_gain"], p["steady_pull"], p["steady_floor_um2"], s["narrow_detuning"], expected, own_um
        )
    else:
        narrow_anew(s)


@compiled
def give_both(s: Record) -> None:
    """Fill the output, ``filtered`` and ``detuning``, from both."""
    share = 1.0 / (1.0 + math.exp(-s["trust"]))
    for i in range(STATES):
        s["filtered"][i] = s["wide"][i] + share * (s["narrow"][i] - s["wide"][i])
    for k in range(MAX_MODES):
        s["detuning"][k] = s["wide_detuning"][k] + share * (s["narrow_detuning"][k] - s["wide_detuning"][k])


@compiled.rare
def keep_given(old: Record, new: Record, s: Record) -> None:
    """With new parameters both continue from the output; equal parameters change nothing."""
    same = old["steady"] == new["steady"] and old["modes"] == new["modes"] and old["returning"] == new["returning"]
    for i in range(STATES):
        same = same and old["gain"][i] == new["gain"][i] and old["steady_gain"][i] == new["steady_gain"][i]
    for k in range(MAX_MODES):
        same = same and old["oscillator"][k] == new["oscillator"][k] and old["decay"][k] == new["decay"][k]
        same = same and old["detuning_low"][k] == new["detuning_low"][k]
        same = same and old["detuning_high"][k] == new["detuning_high"][k]
    if same or not new["steady"]:
        return
    for i in range(STATES):
        s["wide"][i] = s["filtered"][i]
    for k in range(MAX_MODES):
        s["wide_detuning"][k] = s["detuning"][k]
    narrow_anew(s)
