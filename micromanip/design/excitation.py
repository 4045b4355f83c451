"""Excitation signals: the multisine of equation (13), the shrinking triangle of figure 2, seeded noise."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from micromanip.settings.reference import Sine, Sines

Array = NDArray[np.float64]

IDENTIFICATION_HZ = (0.3, 1.0, 2.3, 5.1, 9.7)
IDENTIFICATION_V = (20.0, 13.0, 10.0, 8.0, 5.0)
IDENTIFICATION_OFFSET_V = 78.0


def identification_sines(offset_V: float = IDENTIFICATION_OFFSET_V) -> Sines:
    """The multisine (13) that the hysteresis models are fitted to, as a reference of mode voltage."""
    sines = tuple(
        Sine(amplitude_um=a, frequency_Hz=f) for f, a in zip(IDENTIFICATION_HZ, IDENTIFICATION_V, strict=True)
    )
    return Sines(source="sine", offset_um=offset_V, sines=sines)


def shrinking_triangle(low: float, high: float, turns: int, samples_per_turn: int) -> Array:
    """Linear course from `low` to `high` and back, each of `turns` loops smaller by the same step."""
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    corners = [low]
    for k in range(turns):
        size = half * (1.0 - k / turns)
        corners += [centre + size, centre - size]
    pieces = [np.linspace(a, b, samples_per_turn, endpoint=False) for a, b in itertools.pairwise(corners)]
    return np.concatenate([*pieces, [corners[-1]]])


def band_noise(rms: float, cutoff_hz: float, rate_hz: float, samples: int, seed: int) -> Array:
    """Seeded noise below `cutoff_hz` (two first-order low passes), so that no slew limit distorts it."""
    pole = np.exp(-2.0 * np.pi * cutoff_hz / rate_hz)
    white = np.random.default_rng(seed).standard_normal(samples)
    once = lfilter([1.0 - pole], [1.0, -pole], white)
    coloured = lfilter([1.0 - pole], [1.0, -pole], once)
    return np.asarray(coloured * (rms / coloured.std()), dtype=np.float64)
