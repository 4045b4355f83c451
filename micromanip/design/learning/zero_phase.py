"""Filters that see the whole part: no lag, no start, and inverses that are stable whatever they invert.

A response given over frequency is applied to the spectrum of the whole, mirrored at both ends: a point reflection
would leave the noise of the first and the last value as it is. A non-causal inverse is the only stable one where a
system has zeros outside the unit circle, as sampled mechanics has (Devasia, Chen, Paden, Nonlinear inversion-based
output tracking, 1996); offline nothing speaks against it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Response = Callable[[Array], NDArray[Any]]
"""Gains (n,), complex or not, at frequencies (n,) in Hz."""

ORDER = 8
"""Of the low pass: a Butterworth filter of half of it, run forwards and backwards."""
_STANDING_HZ = 1e-3
"""In the place of 0 Hz, where an integral action has no finite response."""


def low_pass(hertz: Array, corner_hz: float) -> Array:
    """Gain (n,) of the zero-phase low pass, 1/2 at `corner_hz`."""
    return np.asarray(1.0 / (1.0 + (hertz / corner_hz) ** ORDER))


def filtered(x: Array, rate_hz: float, response: Response) -> Array:
    """`x` (n,), `rate_hz` values a second, behind `response`; as if it went on beyond both ends."""
    return _through(np.pad(x, len(x), "symmetric"), rate_hz, response)[len(x) :][: len(x)]


def circulated(x: Array, rate_hz: float, response: Response) -> Array:
    """`x` (n,), one period of what goes round and round, behind `response`."""
    return _through(x, rate_hz, response)


def answered(x: Array, rate_hz: float, response: Response) -> Array:
    """What `response` makes of `x` (n,) with nothing before it and nothing after."""
    return _through(np.pad(x, (0, len(x))), rate_hz, response)[: len(x)]


def _through(x: Array, rate_hz: float, response: Response) -> Array:
    hertz = np.asarray(np.fft.rfftfreq(len(x), 1.0 / rate_hz), dtype=np.float64)
    hertz[0] = min(_STANDING_HZ, 0.5 * hertz[1])
    gains = np.array(response(hertz), dtype=np.complex128)
    gains[0] = gains[0].real
    return np.asarray(np.fft.irfft(np.fft.rfft(x) * gains, len(x)))
