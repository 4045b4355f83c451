"""PID on the strain gauge (17) under a sensitivity limit (section 4.4): as much feedback as margins and noise allow.

What the inverse model leaves over, creep above all, is slow, and feedback removes it; but feedback also passes the
gauge's noise on. The tuning is the one with the least of both together for which Ms stays below its limit at every
slope that the hysteresis gives the actuator, after Astrom and Hagglund, Advanced PID Control, chapter 7: Ms bounds gain
and phase margin at once. Where the plant's resonances leave only weak feedback below a limit, the next one is tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.control.margins import margins
from micromanip.control.pid import pid_response
from micromanip.design.loops import strain_loop
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Inner

from ..loops import Margins, System, grid, refined

Array = NDArray[np.float64]

GAIN_DB, PHASE_DEG = 6.0, 35.0
_LIMITS = ((1.6, 6.0), (2.0, 6.0), (2.2, 4.0))
"""Limits of Ms, and of the gain margin (dB) at the least and the largest slope, tried one after the other."""
_CAREFUL = ((2.0, 6.0),)
_WEAK = 1.6
"""Below this cost a tuning is taken without trying the next limit."""
_RESIDUAL = 0.1
"""A tenth left of what the inverse leaves over at 10 Hz counts as much as the gauge's noise itself."""
_NOISIEST = 1.15
_GAINS, _TIMES_S = np.geomspace(0.03, 3.0, 40), np.geomspace(1e-4, 5e-3, 18)
_DERIVATIVES_S = (0.0, 5e-5, 1e-4, 1.7e-4, 2.5e-4)
_FILTER_MS = 0.3


@dataclass(frozen=True)
class PidDesign:
    """The tuning, its margins at each of the slopes, and what it makes of the gauge's noise.

    `residual_10Hz` is |S| there, what is left of a disturbance.
    """

    inner: Inner
    slopes: tuple[float, ...]
    margins: tuple[Margins, ...]
    noise_gain: float
    residual_10Hz: float

    @property
    def sensitivity(self) -> float:
        """Ms at the worst slope."""
        return max(found.sensitivity for found in self.margins)


def tune_pid(start: Inner, actuator: System, slopes: tuple[float, ...], *, careful: bool = False) -> PidDesign:
    """`start` with gain and times for `actuator` (V to um), its gain times each of `slopes`, rising, 1 among them.

    `careful` takes weak feedback rather than less margin: for an actuator that is only known as far as a bus shows it.
    Raises CheckFailed where none holds a limit of Ms with margins of 6 dB and 35 degrees.
    """
    candidates, best = _candidates(start, actuator, slopes), None
    for limit, outermost_dB in _CAREFUL if careful else _LIMITS:
        for cost, peak, noise_gain, residual, inner in candidates:
            if peak > limit or (best is not None and cost >= best[0]):
                continue
            found = tuple(margins(strain_loop(inner, actuator, slope)) for slope in slopes)
            if all(
                _holds(m, GAIN_DB if slope == 1.0 else outermost_dB) for m, slope in zip(found, slopes, strict=True)
            ):
                best = cost, PidDesign(inner, slopes, found, noise_gain, residual)
                break
        if best is not None and best[0] < _WEAK:
            break
    if best is None:
        raise CheckFailed(
            f"no PID keeps the sensitivity below {_LIMITS[-1][0]:g} with margins of {GAIN_DB:g} dB and {PHASE_DEG:g} "
            f"deg for slopes of {min(slopes):.2f} to {max(slopes):.2f} times the identified one; look at the delay "
            "between output and gauge, and at resonances below 3 kHz"
        )
    return best[1]


def _holds(found: Margins, gain_dB: float) -> bool:
    return found.stable and found.gain_dB >= gain_dB and found.phase_deg >= PHASE_DEG


Candidate = tuple[float, float, float, float, Inner]


def _candidates(start: Inner, actuator: System, slopes: tuple[float, ...]) -> list[Candidate]:
    """Stable tunings as (cost, Ms over all slopes, noise gain, |S| at 10 Hz, tuning), the least cost first."""
    T, unit = actuator.period_s, float(abs(actuator.response(np.array([2 * np.pi]))[0]))
    omega, G = refined(actuator.response, grid(T, actuator.poles))
    even = np.concatenate([[20.0 * np.pi], np.linspace(0.0, np.pi / T, 1001)[1:]])
    even_G = actuator.response(even)
    found = []
    for Td in _DERIVATIVES_S:
        for Ti in _TIMES_S:
            unit_pid = _tuned(start, 1.0, Ti, Td)
            form, even_form = pid_response(unit_pid, T, omega), pid_response(unit_pid, T, even)
            for gain in _GAINS / unit:
                peak = max(float(np.abs(1.0 / (1.0 + slope * gain * form * G)).max()) for slope in slopes)
                if peak > _LIMITS[-1][0]:
                    continue
                S = np.abs(1.0 / (1.0 + gain * even_form * even_G))
                residual, noise_gain = float(S[0]), float(np.sqrt(np.mean(S[1:] ** 2)))
                inner = _tuned(start, gain, Ti, Td)
                # a curve that stays away from -1 may go round it all the same
                if noise_gain <= _NOISIEST and all(_is_stable(strain_loop(inner, actuator, slope)) for slope in slopes):
                    found.append((noise_gain**2 + (residual / _RESIDUAL) ** 2, peak, noise_gain, residual, inner))
    return sorted(found, key=lambda entry: entry[0])


def _tuned(start: Inner, gain: float, Ti: float, Td: float) -> Inner:
    """`start` with another gain and other times (s), rounded as they are written."""
    figures = {"K_V_per_um": gain, "Ti_ms": 1e3 * Ti, "Td_ms": 1e3 * Td}
    rounded = {name: float(f"{value:.4g}") for name, value in figures.items()}
    return start.model_copy(update={"mode": "pid+feedforward", "filter_ms": _FILTER_MS, **rounded})


def _is_stable(loop: System) -> bool:
    return bool(np.abs(np.linalg.eigvals(loop.closed())).max() < 1.0)
