"""Periodic multisine with random phases: what a frequency response and its confidence are measured with.

A period holds whole cycles of 50 and 60 Hz, so that hum falls on lines of its own, which are left out. Several periods
of one draw of the phases show the noise; several draws show what is not linear: Pintelon and Schoukens, System
Identification, 2nd ed., chapters 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
        below = hertz <= max(upper_Hz, hertz[0])
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
