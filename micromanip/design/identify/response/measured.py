"""A multisine, the response at its lines, and how far it can be trusted.

Each draw gives ``G = mean(Y) / mean(U)`` over its periods. What differs from period to period is noise; what differs
from draw to draw is noise and the part of the plant that is not linear. Both in terms of the mean of all draws,
smoothed over neighbouring lines, since there are few of each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from micromanip.control.system import Array, Complex

# A period holds whole cycles of 50 and 60 Hz, so that hum falls on lines of its own, which are left out. Several
# periods of one draw of the phases show the noise; several draws show what is not linear: Pintelon and Schoukens,
# System Identification, 2nd ed., chapters 3 and 4.

PERIOD_S = 3.2
_MAINS_HZ = (50.0, 60.0)
_DENSE_TO_HZ, _SPACING = 200.0, 0.01
"""Every line up to here; above, lines this share apart."""
_TRIALS = 40


@dataclass(frozen=True)
class Multisine:
    """Waves of two (or more) draws: `samples` (n,), of which each draw has `lead` cycles and `periods` whole periods.

    `lines` (k,) are the excited lines, in cycles a period of `period` samples.
    """

    samples: Array
    lines: NDArray[np.int64]
    period: int
    lead: int
    periods: int
    draws: int
    rate_hz: float

    @property
    def frequency_Hz(self) -> Array:
        """Frequencies (k,) of the lines."""
        return np.asarray(self.lines * (self.rate_hz / self.period))


def excited_lines(low_Hz: float, high_Hz: float, period: int, rate_hz: float) -> NDArray[np.int64]:
    """Numbers (k,) of the lines from `low_Hz` to `high_Hz`, mains and its harmonics left out."""
    step = rate_hz / period
    dense = np.arange(np.ceil(low_Hz / step), np.floor(min(high_Hz, _DENSE_TO_HZ) / step) + 1)
    far = np.zeros(0)
    if high_Hz > _DENSE_TO_HZ:
        count = int(np.log(high_Hz / _DENSE_TO_HZ) / _SPACING) + 1
        far = np.round(np.geomspace(_DENSE_TO_HZ, high_Hz, count) / step)
    lines = np.unique(np.concatenate([dense, far])).astype(np.int64)
    hertz = lines * step
    hum = np.min([np.abs(hertz / mains - np.round(hertz / mains)) * mains for mains in _MAINS_HZ], axis=0)
    kept: NDArray[np.int64] = lines[hum > 0.6 * step]
    return kept


def multisine(
    rms: tuple[tuple[float, float], ...],
    low_Hz: float,
    high_Hz: float,
    rate_hz: float,
    *,
    seed: int,
    period_s: float = PERIOD_S,
    lead_s: float = 1.0,
    periods: int = 2,
    draws: int = 2,
) -> Multisine:
    """`rms` has pairs (upper frequency in Hz, rms): each spreads its power evenly over the lines below.

    The phases of each draw are the best of some: the lower the crest, the smaller the swing.
    """
    period, rng = round(period_s * rate_hz), np.random.default_rng(seed)
    lines = excited_lines(low_Hz, high_Hz, period, rate_hz)
    hertz, power = lines * rate_hz / period, np.zeros(len(lines))
    for upper_Hz, size in rms:
        below = hertz <= max(min(upper_Hz, high_Hz), hertz[0])
        power[below] += size**2 / np.count_nonzero(below)
    lead, pieces = round(lead_s * rate_hz), []
    for _ in range(draws):
        wave = _best(lines, np.sqrt(2.0 * power), period, rng)
        pieces += [np.resize(wave, period * (1 + lead // period))[-lead:] if lead else wave[:0], np.tile(wave, periods)]
    return Multisine(np.concatenate(pieces), lines, period, lead, periods, draws, rate_hz)


def _best(lines: NDArray[np.int64], amplitude: Array, period: int, rng: np.random.Generator) -> Array:
    best, least = np.zeros(period), np.inf
    for _ in range(_TRIALS):
        spectrum = np.zeros(period // 2 + 1, complex)
        spectrum[lines] = 0.5 * period * amplitude * np.exp(2j * np.pi * rng.uniform(size=len(lines)))
        wave = np.fft.irfft(spectrum, period)
        if (peak := float(np.abs(wave).max())) < least:
            best, least = wave, peak
    return best


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
