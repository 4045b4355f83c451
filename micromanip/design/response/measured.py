"""The response at the lines of a multisine, and how far it can be trusted.

Each draw gives ``G = mean(Y) / mean(U)`` over its periods. What differs from period to period is noise; what differs
from draw to draw is noise and the part of the plant that is not linear. Both in terms of the mean of all draws,
smoothed over neighbouring lines, since there are few of each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from .excitation import Multisine

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SMOOTHED = 11
"""Lines over which variances are averaged."""


@dataclass(frozen=True)
class Measured:
    """At (k,) frequencies the `response` (k,), that of each draw (draws, k), and its standard deviation (k,).

    `noise` (k,) is the part of the deviation that noise alone makes; the rest is not linear.
    """

    frequency_Hz: Array
    response: Complex
    draws: Complex
    deviation: Array
    noise: Array

    @property
    def relative(self) -> Array:
        """Standard deviation (k,) in terms of the response."""
        return np.asarray(self.deviation / np.maximum(np.abs(self.response), 1e-300))

    @property
    def coherence(self) -> Array:
        """Share (k,) of a period's output that the input explains, 0 .. 1, by the deviation."""
        return np.asarray(1.0 / (1.0 + self.relative**2))


def spectra(wave: Multisine, signal: Array) -> Complex:
    """Lines (draws, periods, k) of a record (n,) made with `wave`; a straight drift over each draw is taken off."""
    per_draw = wave.lead + wave.periods * wave.period
    if len(signal) < wave.draws * per_draw:
        raise ValueError(f"{len(signal)} samples are fewer than the {wave.draws * per_draw} that were played")
    found = []
    for d in range(wave.draws):
        whole = signal[d * per_draw + wave.lead : (d + 1) * per_draw]
        means = whole.reshape(wave.periods, wave.period).mean(axis=1)
        drift = np.polyfit(np.arange(wave.periods), means, 1)[0] / wave.period if wave.periods > 1 else 0.0
        whole = (whole - drift * np.arange(len(whole))).reshape(wave.periods, wave.period)
        found.append(np.fft.rfft(whole, axis=1)[:, wave.lines])
    return np.asarray(found)


def measure(wave: Multisine, u: Array, y: Array) -> Measured:
    """Response from `u` (n,) to `y` (n,), records as long as what was played."""
    return of_spectra(wave.frequency_Hz, spectra(wave, u), spectra(wave, y))


def of_spectra(frequency_Hz: Array, U: Complex, Y: Complex) -> Measured:
    """Response from lines `U` to lines `Y` (draws, periods, k)."""
    draws = Y.mean(axis=1) / U.mean(axis=1)
    # not Y / U: a period in which noise leaves little of U would say more than all others
    rest = (Y - draws[:, None, :] * U) / U.mean(axis=1)[:, None, :]
    count = U.shape[0] * U.shape[1]
    noise = np.sqrt(np.sum(np.abs(rest) ** 2, axis=(0, 1)) / max(count - U.shape[0], 1) / count)
    return _judged(frequency_Hz, draws, noise)


def smoothed(curve: Complex, lines: int) -> Complex:
    """Mean of a curve (k,) over `lines` neighbouring lines; the end ones count on beyond the ends."""
    parts = [uniform_filter1d(part, lines, mode="nearest") for part in (curve.real, curve.imag)]
    return np.asarray(parts[0] + 1j * parts[1])


def _judged(frequency_Hz: Array, draws: Complex, noise: Array) -> Measured:
    mean = draws.mean(axis=0)
    scatter = np.sum(np.abs(draws - mean) ** 2, axis=0) / max(len(draws) - 1, 1) / len(draws)
    # what noise adds knows nothing of the response's size, what is not linear is a share of it; a share of a line that
    # noise happens to leave nothing of would be none of its neighbours'
    of_noise = np.exp(uniform_filter1d(np.log(np.maximum(noise, 1e-300) ** 2), _SMOOTHED, mode="nearest"))
    of_draws, power = (uniform_filter1d(x, _SMOOTHED, mode="nearest") for x in (scatter, np.abs(mean) ** 2))
    deviation = np.sqrt(np.maximum(of_noise, of_draws * np.abs(mean) ** 2 / np.maximum(power, 1e-300)))
    return Measured(frequency_Hz, mean, draws, deviation, np.sqrt(of_noise))
