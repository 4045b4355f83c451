"""The PID (17) behind its notch as the loop steps them: gains, the same as a system, frequency response and phase.

Backward Euler over a step h, which is the loop's period or the time from one sample of a slow gauge to the next:

    I+ = I + K h/Ti e,   D+ = (Tf D + K Td (e - e_before)) / (Tf + h),   u = K e + I+ + D+

Errors in um, u in V. It is stable for every Tf >= 0 and h. The notch (``rt/laws/resonance.py``) is that of s, warped so
that its centre is exact: ``s -> tan(w h / 2) / tan(w0 h / 2)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .system import Array, Complex, System

if TYPE_CHECKING:
    from micromanip.settings.schema.axis import Inner

_MOST_INTERVALS = 2
"""Between samples, that the integral takes for a step."""
FASTEST_NOTCH = 0.45
"""Highest centre of a notch as a share of the rate: beyond, its upper half lies where no sample shows it."""


@dataclass(frozen=True)
class PidGains:
    """Gains per step of `period_s`: the fields of ``rt.laws.pid.PID_PARAMETERS``."""

    K_V_per_um: float
    integral: float
    derivative: float
    filter_s: float
    period_s: float
    tracking: float
    most_periods: int
    notch_share: float = 0.0
    notch_width: float = 1.0
    notch_angle: float = 0.0
    notch_tangent: float = 0.0


def pid_gains(pid: Inner, period_s: float, interval: int = 1) -> PidGains:
    """Gains for a step of `period_s`, with a sample each `interval` of them.

    Raises ValueError where this controller can't be stepped so slowly.
    """
    notch = {}
    if pid.notch is not None:
        centre, angle = pid.notch.frequency_Hz, math.pi * pid.notch.frequency_Hz * period_s
        if angle > FASTEST_NOTCH * math.pi:
            needed, given = centre / FASTEST_NOTCH, 1.0 / period_s
            raise ValueError(f"a notch at {centre:g} Hz needs at least {needed:.0f} samples per second, not {given:g}")
        notch = {
            "notch_share": 0.01 * pid.notch.depth_percent,
            "notch_width": pid.notch.width_Hz / centre,
            "notch_angle": angle,
            "notch_tangent": math.tan(angle),
        }
    return PidGains(
        K_V_per_um=pid.K_V_per_um,
        integral=pid.K_V_per_um * period_s / (pid.Ti_ms * 1e-3),
        derivative=pid.K_V_per_um * pid.Td_ms * 1e-3,
        filter_s=pid.filter_ms * 1e-3,
        period_s=period_s,
        tracking=min(1.0, period_s / (pid.tracking_ms * 1e-3)),
        most_periods=_MOST_INTERVALS * interval,
        **notch,
    )


def pid_system(pid: Inner, period_s: float) -> System:
    """Error (um) to voltage (V), without limits; states: two of the notch, integrator, derivative, error."""
    p = pid_gains(pid, period_s)
    decay, derivative = _derivative(p)
    A = np.array([[1.0, 0.0, 0.0], [0.0, decay, -derivative], [0.0, 0.0, 0.0]])
    B = np.array([p.integral, derivative, 1.0])
    plain = System(A, B, np.array([1.0, decay, -derivative]), p.K_V_per_um + p.integral + derivative, period_s)
    return plain if p.notch_share == 0.0 else _notch_system(p).then(plain)


def pid_response(pid: Inner, period_s: float, omega: Array) -> Complex:
    """Frequency response (n,) in V/um over `omega` (n,), rad/s."""
    p = pid_gains(pid, period_s)
    return _plain_response(p, omega) * _notch_response(p, omega)


def pid_phase(pid: Inner, period_s: float, omega: Array) -> Array:
    """Its phase (n,) in rad, continuous over the frequency: PID and notch each stay within a quarter turn."""
    p = pid_gains(pid, period_s)
    return np.angle(_plain_response(p, omega)) + np.angle(_notch_response(p, omega))


def _derivative(p: PidGains) -> tuple[float, float]:
    """What is left of the filtered derivative a step later, and its gain on the change of the error."""
    return p.filter_s / (p.filter_s + p.period_s), p.derivative / (p.filter_s + p.period_s)


def _plain_response(p: PidGains, omega: Array) -> Complex:
    decay, derivative = _derivative(p)
    back = np.exp(-1j * omega * p.period_s)
    return np.asarray(p.K_V_per_um + p.integral / (1.0 - back) + derivative * (1.0 - back) / (1.0 - decay * back))


def _notch_response(p: PidGains, omega: Array) -> Complex:
    if p.notch_share == 0.0:
        return np.ones(len(omega), complex)
    away = p.notch_tangent / np.tan(0.5 * omega * p.period_s) - np.tan(0.5 * omega * p.period_s) / p.notch_tangent
    return np.asarray(1.0 - p.notch_share / (1.0 - 1j * away / p.notch_width))


def _notch_system(p: PidGains) -> System:
    """The step of ``rt/laws/resonance.py`` as matrices over its two integrators."""
    g, k = p.notch_tangent, p.notch_width
    band = np.array([1.0, -g, g]) / (1.0 + g * (g + k))  # of both states and the input
    low = np.array([0.0, 1.0, 0.0]) + g * band
    step = 2.0 * np.array([band, low]) - np.eye(2, 3)
    taken = p.notch_share * k * band
    return System(step[:, :2], step[:, 2], -taken[:2], 1.0 - float(taken[2]), p.period_s)
