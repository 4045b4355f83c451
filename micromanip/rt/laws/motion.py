"""How the state of a reference goes on, ``w = [p, v, a, o1, o1', ..]``, in closed form; the course of own movements."""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record

from .joints import MAX_MODES


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


@compiled
def minimum_jerk(x: float) -> float:
    """Course of what the controller moves by itself: 0 to 1 for x in 0..1, at rest at both ends."""
    x = max(0.0, min(1.0, x))
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
