"""Margins of a discrete loop from its frequency response, on a grid that is refined where it matters.

``L`` is the loop broken at one place, for negative feedback: the critical point is -1. A margin read off a curve
proves nothing by itself: for a System the closed loop's eigenvalues are given with it, always.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize_scalar

from micromanip.control.system import Array, Complex, Response, System, from_state_space

if TYPE_CHECKING:
    import control

_BASE, _NEAR, _ROUNDS, _LARGEST = 400, 25, 14, 40_000
_ROOT_STEPS, _ROOT = 60, 1e-13
_LOWEST = 1e-5
"""Lowest frequency of the grid as a share of the Nyquist frequency: 0.05 Hz at 10 kHz."""
_TURN = 0.12
"""Between neighbouring points neither L nor 1 + L may turn, or change its logarithm, by more (rad)."""


@dataclass(frozen=True)
class Margins:
    """``gain_up`` > 1 and ``gain_down`` < 1: factors on the gain at which stability is lost (inf and 0: none).

    ``phase_deg``: least rotation of L, either way, that reaches -1 (inf: |L| is never 1), at ``phase_Hz``;
    ``delay_s`` the least delay; ``modulus`` the distance of L to -1, at ``peak_Hz``; ``crossovers_Hz`` where |L| is 1.
    ``radius`` is the largest closed-loop eigenvalue, nan where only a frequency response was given.
    """

    gain_up: float
    gain_down: float
    phase_deg: float
    phase_Hz: float
    delay_s: float
    modulus: float
    peak_Hz: float
    crossovers_Hz: tuple[float, ...]
    radius: float

    @property
    def gain_dB(self) -> float:
        """The smaller of both gain margins, in dB."""
        down = np.inf if self.gain_down == 0.0 else -20.0 * np.log10(self.gain_down)
        return float(min(20.0 * np.log10(self.gain_up), down))

    @property
    def sensitivity(self) -> float:
        """Ms: the peak of 1/|1 + L|."""
        return 1.0 / self.modulus if self.modulus > 0.0 else np.inf

    @property
    def stable(self) -> bool:
        """All closed-loop eigenvalues inside the unit circle; False also where they are not known."""
        return bool(self.radius < 1.0)


def grid(period_s: float, poles: Complex) -> Array:
    """Angular frequencies (n,), rad/s, up to the Nyquist frequency, dense around each of the `poles` (in z)."""
    nyquist = np.pi / period_s
    points = [np.geomspace(_LOWEST * nyquist, nyquist, _BASE)]
    for pole in poles:
        if abs(pole) < 0.2:
            continue
        centre = abs(np.angle(pole)) / period_s
        width = max(abs(np.log(abs(pole))) / period_s, 1e-3 * centre)
        offsets = width * np.geomspace(1e-2, 1e2, _NEAR)
        points += [centre + offsets, centre - offsets]
    omega = np.unique(np.concatenate(points))
    return omega[(omega >= _LOWEST * nyquist) & (omega <= nyquist)]


def refined(response: Response, omega: Array) -> tuple[Array, Complex]:
    """`omega` with points added until L and 1 + L turn little between neighbours; and L there."""
    L = response(omega)
    for _ in range(_ROUNDS):
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = [np.abs(np.log(curve[1:] / curve[:-1])) for curve in (L, 1.0 + L)]
        # far out, where |L| is large, its size does not matter, and far in, where it is small, neither
        steps[0][(np.abs(L[1:]) > 30.0) | (np.abs(L[1:]) < 0.03)] = 0.0
        coarse = np.flatnonzero((np.fmax(steps[0], steps[1]) > _TURN) & (np.diff(omega) > 1e-9 * omega[1:]))
        if not len(coarse) or len(omega) > _LARGEST:
            break
        middle = 0.5 * (omega[coarse] + omega[coarse + 1])
        order = np.argsort(np.concatenate([omega, middle]), kind="stable")
        L = np.concatenate([L, response(middle)])[order]
        omega = np.concatenate([omega, middle])[order]
    kept = np.isfinite(L)
    return omega[kept], L[kept]


def margins(loop: System | control.StateSpace) -> Margins:
    """Margins of the loop transfer `loop`, with the closed loop's eigenvalues."""
    system = loop if isinstance(loop, System) else from_state_space(loop)
    closed = np.linalg.eigvals(system.closed()).astype(complex)
    omega = grid(system.period_s, np.concatenate([system.poles, closed]))
    found = curve_margins(system.response, omega)
    return replace(found, radius=float(np.abs(closed).max(initial=0.0)))


def sensitivity(loop: System) -> float:
    """Ms of the closed loop, on the refined grid; infinite where it is not stable."""
    closed = np.linalg.eigvals(loop.closed()).astype(complex)
    if np.abs(closed).max(initial=0.0) >= 1.0:
        return float(np.inf)
    _, L = refined(loop.response, grid(loop.period_s, np.concatenate([loop.poles, closed])))
    return float(1.0 / np.abs(1.0 + L).min())


def curve_margins(response: Response, omega: Array) -> Margins:
    """Margins of a frequency response alone; `omega` (n,), rad/s, must be dense enough to show every resonance."""
    omega, L = refined(response, omega)
    if len(omega) < 2:
        raise ValueError("the loop's frequency response is nowhere finite")

    def at(w: float) -> complex:
        return complex(response(np.array([w]))[0])

    k = int(np.argmin(np.abs(1.0 + L)))
    low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
    least = minimize_scalar(
        lambda w: abs(1.0 + at(w)), bounds=(low, high), method="bounded", options={"xatol": 1e-10 * high}
    )
    modulus, peak = min((float(least.fun), float(least.x)), (float(abs(1.0 + L[k])), float(omega[k])))
    real = response(_roots(lambda w: response(w).imag, omega, L.imag)).real.tolist()
    real += [float(L[i].real) for i in (0, -1) if abs(L[i].imag) < 1e-9 * abs(L[i])]
    factors = [-1.0 / value for value in real if value < 0.0]
    crossings = _roots(lambda w: np.abs(response(w)) - 1.0, omega, np.abs(L) - 1.0)
    angles = np.angle(-response(crossings))
    lags = (angles % (2 * np.pi)) / crossings
    nearest = int(np.argmin(np.abs(angles))) if len(crossings) else 0
    return Margins(
        gain_up=min((f for f in factors if f > 1.0), default=np.inf),
        gain_down=max((f for f in factors if f < 1.0), default=0.0),
        phase_deg=float(np.degrees(np.abs(angles[nearest]))) if len(crossings) else np.inf,
        phase_Hz=float(crossings[nearest] / (2 * np.pi)) if len(crossings) else np.nan,
        delay_s=float(lags.min(initial=np.inf)),
        modulus=modulus,
        peak_Hz=peak / (2 * np.pi),
        crossovers_Hz=tuple(float(w / (2 * np.pi)) for w in crossings),
        radius=np.nan,
    )


def _roots(function: Callable[[Array], Array], omega: Array, values: Array) -> Array:
    """Zeros (k,) of `function` between neighbouring points where `values` change sign."""
    i = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    if not len(i):
        return np.zeros(0)
    low, high, f_low, f_high = omega[i], omega[i + 1], values[i], values[i + 1]
    x = low
    # regula falsi, the end that stays halved (Illinois): the grid is fine, so a few steps are enough
    for _ in range(_ROOT_STEPS):
        x = (low * f_high - high * f_low) / (f_high - f_low)
        f = function(x)
        if np.all((np.abs(high - low) < _ROOT * x) | (np.abs(f) < _ROOT)):
            break
        crossed = f * f_high < 0.0
        low, f_low = np.where(crossed, high, low), np.where(crossed, f_high, 0.5 * f_low)
        high, f_high = x, np.where(f == 0.0, 1e-300, f)
    return np.asarray(x)
