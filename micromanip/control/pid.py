"""The PID (17) as the loop steps it: its gains, the same controller as a system, its frequency response and phase.

Backward Euler over a step h, which is the loop's period or the time from one sample of a slow gauge to the next:

    I+ = I + K h/Ti e,   D+ = (Tf D + K Td (e - e_before)) / (Tf + h),   u = K e + I+ + D+

Errors in um, u in V. It is stable for every Tf >= 0 and h.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .system import Array, Complex, System


class PidSettings(Protocol):
    """What people write: gain and times."""

    @property
    def K_V_per_um(self) -> float: ...
    @property
    def Ti_ms(self) -> float: ...
    @property
    def Td_ms(self) -> float: ...
    @property
    def filter_ms(self) -> float: ...
    @property
    def tracking_ms(self) -> float: ...


@dataclass(frozen=True)
class PidGains:
    """Gains per step of `period_s`: the fields of ``rt.laws.pid.PID_PARAMETERS``."""

    gain: float
    integral: float
    derivative: float
    filter_s: float
    period_s: float
    tracking: float


def pid_gains(pid: PidSettings, period_s: float) -> PidGains:
    """Gains for a step of `period_s`; raises ValueError where this controller can't be stepped so slowly."""
    return PidGains(
        gain=pid.K_V_per_um,
        integral=pid.K_V_per_um * period_s / (pid.Ti_ms * 1e-3),
        derivative=pid.K_V_per_um * pid.Td_ms * 1e-3,
        filter_s=pid.filter_ms * 1e-3,
        period_s=period_s,
        tracking=min(1.0, period_s / (pid.tracking_ms * 1e-3)),
    )


def pid_system(pid: PidSettings, period_s: float) -> System:
    """Error (um) to voltage (V), without limits; states: integrator, derivative, error."""
    p = pid_gains(pid, period_s)
    decay, derivative = _derivative(p)
    A = np.array([[1.0, 0.0, 0.0], [0.0, decay, -derivative], [0.0, 0.0, 0.0]])
    B = np.array([p.integral, derivative, 1.0])
    return System(A, B, np.array([1.0, decay, -derivative]), p.gain + p.integral + derivative, period_s)


def pid_response(pid: PidSettings, period_s: float, omega: Array) -> Complex:
    """Frequency response (n,) in V/um over `omega` (n,), rad/s."""
    p = pid_gains(pid, period_s)
    decay, derivative = _derivative(p)
    back = np.exp(-1j * omega * period_s)
    return np.asarray(p.gain + p.integral / (1.0 - back) + derivative * (1.0 - back) / (1.0 - decay * back))


def pid_phase(pid: PidSettings, period_s: float, omega: Array) -> Array:
    """Its phase (n,) in rad, continuous over the frequency: the PID's own stays within a quarter turn either way."""
    return np.angle(pid_response(pid, period_s, omega))


def _derivative(p: PidGains) -> tuple[float, float]:
    """What is left of the filtered derivative a step later, and its gain on the change of the error."""
    return p.filter_s / (p.filter_s + p.period_s), p.derivative / (p.filter_s + p.period_s)
