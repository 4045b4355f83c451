"""PID on the strain gauge (17) by maximum integral gain under a sensitivity limit (section 4.4).

What the inverse model leaves over, creep above all, is slow: the integral gain K/Ti removes it. So K/Ti is made as
large as margins allow, for every slope that the hysteresis gives the actuator, after Astrom and Hagglund, Advanced PID
Control, chapter 7: Ms bounds gain and phase margin at once, the noise gain what the gauge's noise costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.settings.axis import Inner

from ..loops import Margins, System, grid, margins, refined, strain_loop

Array = NDArray[np.float64]

SENSITIVITY, GAIN_DB, PHASE_DEG = 1.6, 6.0, 35.0
NOISE_GAIN = 1.08
"""The measured error may be so much noisier than the gauge itself; feedback can't make it quieter."""
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


def tune_pid(actuator: System, slopes: tuple[float, ...], *, sensitivity: float = SENSITIVITY) -> PidDesign:
    """The PID for `actuator` (V to um) with its gain multiplied by each of `slopes`.

    Raises CheckFailed where no PID holds Ms <= `sensitivity`, 6 dB and 35 degrees at all of them.
    """
    unit = float(abs(actuator.response(np.array([2 * np.pi]))[0]))
    for inner in _by_gain(actuator, slopes, sensitivity, unit):
        found = tuple(margins(strain_loop(inner, actuator, slope)) for slope in slopes)
        if all(_holds(each, sensitivity) for each in found):
            return PidDesign(inner, slopes, found, *_costs(strain_loop(inner, actuator)))
    raise CheckFailed(
        f"no PID keeps the sensitivity below {sensitivity:g} with margins of {GAIN_DB:g} dB and {PHASE_DEG:g} deg for "
        f"slopes of {min(slopes):.2f} to {max(slopes):.2f} times the identified one; look at the delay between output "
        "and gauge, and at resonances below 1 kHz"
    )


def _holds(found: Margins, sensitivity: float) -> bool:
    return (
        found.stable and found.sensitivity <= sensitivity and found.gain_dB >= GAIN_DB and found.phase_deg >= PHASE_DEG
    )


def _costs(loop: System) -> tuple[float, float]:
    """Noise gain (rms of S over all frequencies) and |S| at 10 Hz."""
    omega = np.linspace(0.0, np.pi / loop.period_s, 4001)[1:]
    S = 1.0 / (1.0 + loop.response(omega))
    at = 1.0 / (1.0 + loop.response(np.array([20.0 * np.pi])))
    return float(np.sqrt(np.mean(np.abs(S) ** 2))), float(abs(at[0]))


def _by_gain(actuator: System, slopes: tuple[float, ...], sensitivity: float, unit: float) -> list[Inner]:
    """Tunings that hold the limits on a grid of frequencies, the largest integral gain first."""
    omega, G = refined(actuator.response, grid(actuator.period_s, actuator.poles))
    even = np.linspace(0.0, np.pi / actuator.period_s, 1001)[1:]
    back, T = np.exp(-1j * omega * actuator.period_s), actuator.period_s
    even_back, even_G = np.exp(-1j * even * T), actuator.response(even)
    found = []
    for Td in _DERIVATIVES_S:
        for Ti in _TIMES_S:
            form, even_form = _unit_pid(back, Ti, Td, T), _unit_pid(even_back, Ti, Td, T)
            for gain in _GAINS / unit:
                peak = max(float(np.abs(1.0 / (1.0 + slope * gain * form * G)).max()) for slope in slopes)
                if peak > sensitivity:
                    continue
                noise = float(np.sqrt(np.mean(np.abs(1.0 / (1.0 + gain * even_form * even_G)) ** 2)))
                inner = _rounded(gain, Ti, Td)
                # a curve that stays away from -1 may go round it all the same
                if noise <= NOISE_GAIN and all(_is_stable(strain_loop(inner, actuator, slope)) for slope in slopes):
                    found.append((gain / Ti, inner))
    found.sort(key=lambda entry: -entry[0])
    return [inner for _, inner in found]


def _rounded(gain: float, Ti: float, Td: float) -> Inner:
    return Inner(
        mode="pid+feedforward",
        K_V_per_um=float(f"{gain:.4g}"),
        Ti_ms=float(f"{1e3 * Ti:.4g}"),
        Td_ms=float(f"{1e3 * Td:.4g}"),
        filter_ms=_FILTER_MS,
    )


def _is_stable(loop: System) -> bool:
    return bool(np.abs(np.linalg.eigvals(loop.closed())).max() < 1.0)


def _unit_pid(back: NDArray[np.complex128], Ti: float, Td: float, T: float) -> NDArray[np.complex128]:
    """The loop's PID (17) for K = 1 over ``back = 1/z``."""
    decay = _FILTER_MS * 1e-3 / (_FILTER_MS * 1e-3 + T)
    derivative = Td / (_FILTER_MS * 1e-3 + T) * (1.0 - back) / (1.0 - decay * back)
    return np.asarray(1.0 + T / Ti / (1.0 - back) + derivative)
