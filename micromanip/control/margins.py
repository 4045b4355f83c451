"""Margins of a discrete loop from its frequency response, on a grid that is refined where it matters.

``L`` is the loop broken at one place, for negative feedback: the critical point is -1. A margin read off a curve
proves nothing by itself: for a System the closed loop's eigenvalues are given with it, always.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from micromanip.control.system import Array, Complex, Response, System

Unsure = Callable[[Array], Array]
"""Uncertainty (n,) of a plant's response at angular frequencies (n,), as a share of it."""
_ROUNDS, _LARGEST = 14, 40_000
_ROOT_STEPS, _ROOT = 60, 1e-13
_LOWEST = 1e-5
"""Lowest frequency of the grid as a share of the Nyquist frequency: 0.05 Hz at 10 kHz."""
_SHARES = np.geomspace(_LOWEST, 1.0, 400)
_OFFSETS = np.geomspace(1e-2, 1e2, 25)
"""Of points around a pole, in widths of it."""
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
    sizes = np.abs(poles)
    near, sizes = np.asarray(poles)[sizes >= 0.2], sizes[sizes >= 0.2]
    centre = np.abs(np.angle(near)) / period_s
    width = np.maximum(np.abs(np.log(sizes)) / period_s, 1e-3 * centre)
    offsets = width[:, None] * _OFFSETS
    points = [nyquist * _SHARES, (centre[:, None] + offsets).ravel(), (centre[:, None] - offsets).ravel()]
    omega = np.unique(np.concatenate(points))
    return omega[(omega >= _LOWEST * nyquist) & (omega <= nyquist)]


def refined(response: Response, omega: Array) -> tuple[Array, Complex]:
    """`omega` with points added until L and 1 + L turn little between neighbours; and L there."""
    L = response(omega)
    points, curve = [omega], [L]
    low, high, L_low, L_high = omega[:-1], omega[1:], L[:-1], L[1:]
    count = len(omega)
    for _ in range(_ROUNDS):
        coarse = _turns(L_low, L_high) & (high - low > 1e-9 * high)
        if not coarse.any() or count > _LARGEST:
            break
        low, high, L_low, L_high = low[coarse], high[coarse], L_low[coarse], L_high[coarse]
        middle = 0.5 * (low + high)
        L_middle = response(middle)
        points.append(middle)
        curve.append(L_middle)
        count += len(middle)
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        L_low, L_high = np.concatenate([L_low, L_middle]), np.concatenate([L_middle, L_high])
    omega, L = np.concatenate(points), np.concatenate(curve)
    order = np.argsort(omega, kind="stable")
    kept = order[np.isfinite(L[order])]
    return omega[kept], L[kept]


def _turns(low: Complex, high: Complex) -> NDArray[np.bool_]:
    """Whether L or 1 + L turns by much from `low` to `high`, values of L (n,) at neighbouring frequencies."""
    with np.errstate(divide="ignore", invalid="ignore"):
        own, of_return = (np.abs(np.log(after / before)) for before, after in ((low, high), (1.0 + low, 1.0 + high)))
    # far out, where |L| is large, its size does not matter, and far in, where it is small, neither
    own[(np.abs(high) > 30.0) | (np.abs(high) < 0.03)] = 0.0
    return np.asarray(np.fmax(own, of_return) > _TURN)


def margins(loop: System) -> Margins:
    """Margins of the loop transfer `loop`, with the closed loop's eigenvalues."""
    closed = np.linalg.eigvals(loop.closed()).astype(complex)
    omega = grid(loop.period_s, np.concatenate([loop.poles, closed]))
    found = curve_margins(loop.response, omega)
    return replace(found, radius=float(np.abs(closed).max(initial=0.0)))


def sensitivity(loop: System) -> float:
    """Ms of the closed loop, on the refined grid; infinite where it is not stable."""
    closed = np.linalg.eigvals(loop.closed()).astype(complex)
    if np.abs(closed).max(initial=0.0) >= 1.0:
        return float(np.inf)
    _, L = refined(loop.response, grid(loop.period_s, np.concatenate([loop.poles, closed])))
    return float(1.0 / np.abs(1.0 + L).min())


def within(found: Margins, loop: System, unsure: Unsure) -> Margins:
    """`found` of `loop`, with the worst gain margin and distance to -1 of any plant that is as near as it is known.

    L is anywhere in discs of radius ``|L| unsure``. The phase margin stays that of the model.
    """
    omega, L = refined(loop.response, grid(loop.period_s, loop.poles))
    i = np.flatnonzero(L.imag[:-1] * L.imag[1:] <= 0.0)  # small discs reach the axis between points of the grid
    added = np.concatenate([[2 * np.pi * found.peak_Hz], np.linspace(omega[i], omega[i + 1], 40).ravel()])
    omega, L = np.concatenate([omega, added]), np.concatenate([L, loop.response(added)])
    radius = np.abs(L) * unsure(omega)
    real = radius > np.abs(L.imag)  # discs that reach the real axis
    half = np.sqrt(radius[real] ** 2 - L.imag[real] ** 2)
    ends = np.concatenate([L.real[real] - half, L.real[real] + half])
    factors, near = -1.0 / ends[ends < 0.0], np.abs(1.0 + L) - radius
    k = int(np.argmin(near))
    if near[k] <= 0.0:  # -1 itself may be reached
        return replace(found, gain_up=1.0, gain_down=1.0, modulus=0.0, peak_Hz=float(omega[k]) / (2 * np.pi))
    return replace(
        found,
        gain_up=min([found.gain_up, *factors[factors > 1.0].tolist()]),
        gain_down=max([found.gain_down, *factors[factors < 1.0].tolist()]),
        modulus=min(found.modulus, float(near[k])),
        peak_Hz=found.peak_Hz if near[k] >= found.modulus else float(omega[k]) / (2 * np.pi),
    )


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
