"""PID on the strain gauge (17) under a sensitivity limit (section 4.4): as much feedback as margins and noise allow.

What the inverse model leaves over, creep above all, is slow, and feedback removes it; but feedback also passes the
gauge's noise on. The tuning is the one with the least of both together for which Ms stays below its limit at every
slope that the hysteresis gives the actuator, wherever within its uncertainty the measured response may be; after Astrom
and Hagglund, Advanced PID Control, chapter 7: Ms bounds gain and phase margin at once. Gain, times, the derivative's
filter and a notch are free: a coarse search over all of them, the best polished. Where the plant leaves only weak
feedback below a limit, the next one is tried; what limits it is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from micromanip.control.margins import Margins, grid, margins, refined
from micromanip.control.pid import FASTEST_NOTCH, pid_response
from micromanip.control.system import Array, Complex, System
from micromanip.design.analyse.loops import damped, strain_loop
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Inner, Notch

Radius = Callable[[Array], Array]

GAIN_DB, PHASE_DEG = 6.0, 35.0
_RESERVE = 1.03
"""Margins are kept better than asked by this: the next measurement gives a slightly other model."""
_LIMITS, _CAREFUL = (1.6, 1.8, 2.0), (1.8, 2.0)
"""Of Ms, tried one after the other."""
_WEAK = 1.6
"""Below this cost a tuning is taken without trying the next limit."""
RESIDUAL = 0.1
"""A tenth left of what the inverse leaves over at 10 Hz counts as much as the gauge's noise itself."""
_NOISIEST = 1.15
_FAST_SHARE, _FASTEST = 0.2, 0.55
"""Above this share of the Nyquist frequency the controller times the slow slope stays below the other: there only the
lags of amplifier and gauge would hold the loop, which a spare part may not have."""
_GAINS = np.geomspace(0.001, 6.0, 88)
_TIMES_S = np.geomspace(1e-4, 1e-2, 13)
_DERIVATIVES_S, _FILTERS_S = (5e-5, 1.2e-4, 2.5e-4, 5e-4, 8e-4), (3e-5, 6e-5, 1.1e-4, 3e-4)
_NOTCH_WIDTHS, _LIGHTLY, _NOTCHED = (0.25, 0.8), 0.1, 2
_CHECKED, _POLISHED = 150, 160
_SHAPE = tuple[float, float, float, Notch | None]


@dataclass(frozen=True)
class PidDesign:
    """The tuning, its margins at each of the slopes, and what it makes of the gauge's noise.

    `residual_10Hz` is |S| there, what is left of a disturbance; `limited_by` says in words what stands in the way of
    more.
    """

    inner: Inner
    slopes: tuple[float, ...]
    margins: tuple[Margins, ...]
    noise_gain: float
    residual_10Hz: float
    limited_by: str

    @property
    def sensitivity(self) -> float:
        """Ms at the worst slope."""
        return max(found.sensitivity for found in self.margins)

    def bears(self, share: float, actuator: System, gain_dB: float, phase_deg: float) -> bool:
        """Whether the margins are there with `share` of the gain, too, and Ms is below the last of its limits."""
        inner = self.inner.model_copy(update={"K_V_per_um": share * self.inner.K_V_per_um})
        found = [margins(strain_loop(inner, actuator, slope)) for slope in self.slopes]
        return _hold(found, gain_dB, phase_deg) and all(m.sensitivity <= _LIMITS[-1] for m in found)


@dataclass(frozen=True)
class _Task:
    """What a tuning is judged by: the actuator at frequencies (n,), dense for margins, even for noise."""

    start: Inner
    actuator: System
    slopes: tuple[float, ...]
    residual: float
    gain_dB: float
    phase_deg: float
    unsure: Radius | None

    @cached_property
    def _dense(self) -> tuple[Array, Complex]:
        return refined(self.actuator.response, grid(self.actuator.period_s, self.actuator.poles))

    @property
    def omega(self) -> Array:
        """Frequencies for margins."""
        return self._dense[0]

    @property
    def G(self) -> Complex:
        """The actuator's response there."""
        return self._dense[1]

    @cached_property
    def radius(self) -> Array:
        """And how far it may be off."""
        return np.zeros(len(self.omega)) if self.unsure is None else self.unsure(self.omega)

    @cached_property
    def even(self) -> Array:
        """10 Hz, and frequencies for noise."""
        return np.concatenate([[20.0 * np.pi], np.linspace(0.0, np.pi / self.actuator.period_s, 501)[1:]])

    @cached_property
    def even_G(self) -> Complex:
        """The response there."""
        return self.actuator.response(self.even)

    def figures(self, inner: Inner) -> tuple[float, float, float]:
        """Noise gain, |S| at 10 Hz, and Ms over all slopes and the uncertainty."""
        T = self.actuator.period_s
        C = pid_response(inner, T, self.omega)
        S = np.abs(1.0 / (1.0 + pid_response(inner, T, self.even) * self.even_G))
        return float(np.sqrt(np.mean(S[1:] ** 2))), float(S[0]), max(self.peak(s * C) for s in self.slopes)

    def peak(self, C: Complex) -> float:
        """Ms with a controller (n,)."""
        return float(1.0 / np.maximum(np.abs(1.0 + C * self.G) - np.abs(C) * self.radius, 1e-3).min())

    def fast(self, C: Complex) -> float:
        """Largest gain of a controller (n,) where it is fast, times the slow slope."""
        high = self.omega > _FAST_SHARE * np.pi / self.actuator.period_s
        return float(np.abs(C[high]).max() * np.abs(self.even_G[0]))

    def cost(self, noise_gain: float, residual: float) -> float:
        return noise_gain**2 + (residual / self.residual) ** 2

    def stable(self, inner: Inner) -> bool:
        """A curve that stays away from -1 may go round it all the same."""
        return all(
            np.abs(np.linalg.eigvals(strain_loop(inner, self.actuator, s).closed())).max() < 1.0 for s in self.slopes
        )

    def margins(self, inner: Inner) -> tuple[Margins, ...]:
        return tuple(margins(strain_loop(inner, self.actuator, slope)) for slope in self.slopes)

    def holds(self, inner: Inner) -> bool:
        """Whether all margins are there."""
        return _hold(self.margins(inner), self.gain_dB, self.phase_deg)


def _hold(found: Iterable[Margins], gain_dB: float, phase_deg: float) -> bool:
    return all(m.stable and m.gain_dB >= gain_dB and m.phase_deg >= phase_deg for m in found)


def tune_pid(
    start: Inner,
    actuator: System,
    slopes: tuple[float, ...],
    *,
    careful: bool = False,
    radius: Radius | None = None,
    gain_dB: float = GAIN_DB,
    phase_deg: float = PHASE_DEG,
    residual: float = RESIDUAL,
) -> PidDesign:
    """`start` with gain, times and notch for `actuator` (V to um), its gain times each of `slopes`, 1 among them.

    `radius` gives the uncertainty (um/V) of the actuator's response at angular frequencies, `residual` the share of a
    disturbance at 10 Hz that counts as much as the gauge's noise. `careful` takes weak feedback rather than less
    margin. Raises CheckFailed where none holds a limit of Ms with these margins, with what stands in the way.
    """
    task = _Task(start, actuator, slopes, residual, _RESERVE * gain_dB, _RESERVE * phase_deg, radius)
    candidates = _candidates(task)
    best: tuple[float, Inner] | None = None
    for limit in _CAREFUL if careful else _LIMITS:
        found = _best(task, candidates, limit)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
        if best is not None and best[0] < _WEAK:
            break
    if best is None:
        least = min(candidates, key=lambda entry: entry[1], default=None)
        stands = "" if least is None else f": {_limit(task, _tuned(task.start, least[2], *least[3]))}"
        raise CheckFailed(
            f"no PID keeps the sensitivity below {_LIMITS[-1]:g} with margins of {gain_dB:g} dB and {phase_deg:g} "
            f"deg for slopes of {min(slopes):.2f} to {max(slopes):.2f} times the identified one{stands}"
        )
    inner = best[1]
    noise_gain, left, _ = task.figures(inner)
    return PidDesign(inner, slopes, task.margins(inner), noise_gain, left, _limit(task, inner))


Candidate = tuple[float, float, float, _SHAPE]


def _candidates(task: _Task) -> list[Candidate]:
    """Tunings as (cost, Ms over slopes and uncertainty, gain in V/um, shape), the least cost first."""
    unit = float(np.abs(task.even_G[0]))
    step = float(np.log(_GAINS[1] / _GAINS[0]))
    # a gain times a slope is another gain of the same row
    shifts = [round(float(np.log(slope)) / step) for slope in task.slopes]
    found: list[Candidate] = []
    for shape in _shapes(task):
        row = _tuned(task.start, 1.0, *shape)
        form = pid_response(row, task.actuator.period_s, task.omega) / unit
        even = pid_response(row, task.actuator.period_s, task.even) / unit
        forms, far = form * task.G, np.abs(form) * task.radius
        highest = _lost(forms) / (10.0 ** (task.gain_dB / 20.0) * max(task.slopes))
        highest = min(highest, _FASTEST / task.fast(form))
        tried = _GAINS[: max(0, np.searchsorted(_GAINS, highest, "right") + max(shifts)), None]
        near = np.abs(1.0 + tried * forms) - tried * far
        peaks = 1.0 / np.maximum(near.min(axis=1), 1e-3)
        for i, gain in enumerate(_GAINS):
            reached = [i + shift for shift in shifts]
            if min(reached) < 0 or max(reached) >= len(_GAINS) or gain > highest:
                continue
            peak = float(peaks[reached].max())
            if peak > _LIMITS[-1]:
                continue
            S = np.abs(1.0 / (1.0 + gain * even * task.even_G))
            noise_gain, left = float(np.sqrt(np.mean(S[1:] ** 2))), float(S[0])
            if noise_gain <= _NOISIEST:
                found.append((task.cost(noise_gain, left), peak, gain / unit, shape))
    return sorted(found, key=lambda entry: entry[0])


def _lost(forms: Complex) -> float:
    """Gain at which a loop that is stable with little gain first loses its stability."""
    turns = np.flatnonzero(forms.imag[:-1] * forms.imag[1:] < 0.0)
    share = forms.imag[turns] / (forms.imag[turns] - forms.imag[turns + 1])
    real = forms.real[turns] + share * (forms.real[turns + 1] - forms.real[turns])
    least = float(np.min(np.append(real, forms.real[-1])))
    return -1.0 / least if least < 0.0 else np.inf


def _shapes(task: _Task) -> list[_SHAPE]:
    notches: list[Notch | None] = [None]
    for frequency in _modes(task.actuator)[:_NOTCHED]:
        notches += [_notch(frequency, width * frequency) for width in _NOTCH_WIDTHS]
    pairs = [(0.0, _FILTERS_S[1])] + [(Td, Tf) for Td in _DERIVATIVES_S for Tf in _FILTERS_S]
    # a notch takes the place of the derivative: both at once are left to the polish
    shapes = [(Ti, Td, Tf, None) for Ti in _TIMES_S for Td, Tf in pairs]
    return shapes + [(Ti, Td, _FILTERS_S[2], n) for Ti in _TIMES_S for Td in (0.0, 2.5e-4) for n in notches[1:]]


def _modes(actuator: System) -> list[float]:
    """Frequencies (Hz) of lightly damped poles that a notch can stand on, the slowest first."""
    poles = actuator.poles[(actuator.poles.imag > 1e-9) & (np.abs(actuator.poles) > 0.1)]
    modes = [damped(pole, actuator.period_s) for pole in poles]
    return sorted(hz for hz, damping in modes if damping < _LIGHTLY and hz * actuator.period_s < 0.4)


def _notch(frequency: float, width: float) -> Notch:
    return Notch(frequency_Hz=float(f"{frequency:.4g}"), width_Hz=float(f"{width:.4g}"))


def _tuned(start: Inner, gain: float, Ti: float, Td: float, Tf: float, notch: Notch | None) -> Inner:
    """`start` with another gain and other times (s), rounded as they are written."""
    figures = {"K_V_per_um": gain, "Ti_ms": 1e3 * Ti, "Td_ms": 1e3 * Td, "filter_ms": 1e3 * Tf}
    rounded = {name: float(f"{value:.4g}") for name, value in figures.items()}
    return start.model_copy(update={"mode": "pid+feedforward", "notch": notch, **rounded})


def _best(task: _Task, candidates: list[Candidate], limit: float) -> tuple[float, Inner] | None:
    """The cheapest that holds Ms and margins, and polished where that is cheaper still."""
    checked = 0
    for cost, peak, gain, shape in candidates:
        if peak > limit or checked >= _CHECKED:
            continue
        checked += 1
        inner = _tuned(task.start, gain, *shape)
        if not task.stable(inner) or not task.holds(inner):
            continue
        polished = _polished(task, inner, limit)
        return (cost, inner) if polished is None or polished[0] >= cost else polished
    return None


def _polished(task: _Task, inner: Inner, limit: float) -> tuple[float, Inner] | None:
    """All figures moved at once, from a tuning that holds."""
    fixed, highest = inner.notch, np.log(0.999 * FASTEST_NOTCH / task.actuator.period_s)  # before it is rounded

    def at(x: Array) -> Inner:
        K, Ti, Td, Tf = np.exp(x[:4])
        notch = None if fixed is None else _notch(float(np.exp(x[4])), float(np.exp(x[5])))
        return _tuned(task.start, K, Ti, Td if Td > 1e-5 else 0.0, Tf, notch)

    def cost(x: Array) -> float:
        if np.abs(x - begin).max() > 2.0 or (fixed is not None and x[4] > highest):
            return 1e6
        tried = at(x)
        noise_gain, left, peak = task.figures(tried)
        fast = task.fast(pid_response(tried, task.actuator.period_s, task.omega))
        if peak > limit or noise_gain > _NOISIEST or fast > _FASTEST or not task.stable(tried):
            return 1e3 * min(peak, 1e3)
        return task.cost(noise_gain, left)

    figures = [inner.K_V_per_um, 1e-3 * inner.Ti_ms, max(1e-3 * inner.Td_ms, 1.5e-5), 1e-3 * inner.filter_ms]
    if fixed is not None:
        figures += [fixed.frequency_Hz, fixed.width_Hz]
    begin = np.log(figures)
    simplex = np.vstack([begin, begin + 0.25 * np.eye(len(begin))])
    result = minimize(cost, begin, method="Nelder-Mead", options={"maxfev": _POLISHED, "initial_simplex": simplex})
    tuned = at(result.x)
    return (float(result.fun), tuned) if result.fun < 1e3 and task.holds(tuned) else None


def _limit(task: _Task, inner: Inner) -> str:
    """Where the sensitivity peaks at its worst slope, what is there, and what would help."""
    worst = max(task.margins(inner), key=lambda m: m.sensitivity)
    hertz, T = worst.peak_Hz, task.actuator.period_s
    near = [f for f in _modes(task.actuator) if abs(np.log(f / max(hertz, 1e-3))) < 0.35]
    where = f"Ms peaks at {hertz:.0f} Hz"
    if near:
        return f"{where}, by the mode at {near[0]:.0f} Hz: more damping there, or a stiffer mount, would allow more"
    lag = -float(np.unwrap(np.angle(task.G))[np.searchsorted(task.omega, 2 * np.pi * hertz)]) / (2 * np.pi * hertz)
    return (
        f"{where}, where amplifier, gauge and delay are {1e3 * lag:.2f} ms late ({lag / T:.1f} cycles): a faster "
        "amplifier, a faster gauge or fewer cycles of delay would allow more"
    )
