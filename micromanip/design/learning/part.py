"""One part out of a run: path, error and what was played, on an even grid, without lag.

The error is the path, as the tracker's samples show it at the times when they were taken, less the measured stage.
Noise of the tracker that the loop has followed is in both, and so hardly in the error. What was played is what the loop
recorded of it.

The part as a spectrum: filters that see the whole of it, and which frequencies of the error repeat.

**Filters** have no lag and no start, and inverses are stable whatever they invert. A response given over frequency is
applied to the spectrum of the whole, mirrored at both ends: a point reflection would leave the noise of the first and
the last value as it is. A non-causal inverse is the only stable one where a system has zeros outside the unit circle,
as sampled mechanics has (Devasia, Chen, Paden, Nonlinear inversion-based output tracking, 1996).

**Bands** have a power, a spread from part to part, and a confidence. In a band of the mean of n parts with power S, of
which the spread R from part to part leaves R / n by chance, the share that repeats is estimated without bias by
``1 - R / (n S)``: that is Wiener's gain for it. R is the larger of the band's own spread and that of the bands about
it: the own is small by chance in one band of so many, and that band would be taken. A share is taken where S is beyond
what chance makes, anywhere in the whole spectrum, of the spread about it in 99 of 100 updates, and of its own in 99 of
100 bands (F distribution); elsewhere it is 0: what is not sure is not played. A single part has no spread, so nothing
of it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.stats import f as fisher

from micromanip.control.system import Array, Complex
from micromanip.errors import CheckFailed
from micromanip.rt.telemetry import DEVIATION_FRESH

Response = Callable[[Array], NDArray[Any]]
"""Gains (n,), complex or not, at frequencies (n,) in Hz."""

ORDER = 8
"""Of the low pass: a Butterworth filter of half of it, run forwards and backwards."""
_STANDING_HZ = 1e-3
"""In the place of 0 Hz, where an integral action has no finite response."""
_LINES, _LEAST_HZ = 8, 0.5
"""A band has so many lines at least, and is as wide at least."""
_NEXT, _NEXT_BUT_ONE = 4.0 / 9.0, 1.0 / 36.0
"""Of a line's power, behind a Hann window, what it has in common with its neighbours on either side."""
_ABOUT, _OF_THEM = 11, 7.0
"""Bands whose median is the floor about a line; how many they stand for, as a median is less certain than a mean."""
_CHANCE, _OWN_CHANCE = 0.01, 0.01
"""That any band of an update is taken by chance, as it would play noise; that one is by its own spread."""


def low_pass(hertz: Array, corner_hz: float) -> Array:
    """Gain (n,) of the zero-phase low pass, 1/2 at `corner_hz`."""
    return np.asarray(1.0 / (1.0 + (hertz / corner_hz) ** ORDER))


def filtered(x: Array, rate_hz: float, response: Response) -> Array:
    """`x` (n,), `rate_hz` values a second, behind `response`; as if it went on beyond both ends."""
    return _through(np.pad(x, len(x), "symmetric"), rate_hz, response)[len(x) :][: len(x)]


def answered(x: Array, rate_hz: float, response: Response) -> Array:
    """What `response` makes of `x` (n,) with nothing before it and nothing after."""
    return _through(np.pad(x, (0, len(x))), rate_hz, response)[: len(x)]


def _through(x: Array, rate_hz: float, response: Response) -> Array:
    hertz = np.asarray(np.fft.rfftfreq(len(x), 1.0 / rate_hz), dtype=np.float64)
    hertz[0] = min(_STANDING_HZ, 0.5 * hertz[1])
    gains = np.array(response(hertz), dtype=np.complex128)
    gains[0] = gains[0].real
    return np.asarray(np.fft.irfft(np.fft.rfft(x) * gains, len(x)))


class Bands:
    """Bands of the spectrum of `values` values, `rate_hz` a second, up to `highest_hz`."""

    def __init__(self, values: int, rate_hz: float, highest_hz: float) -> None:
        """The highest band lies below `highest_hz` as a whole."""
        seconds = values / rate_hz
        self._lines = max(_LINES, round(_LEAST_HZ * seconds))
        self.count = max(0, int(highest_hz * seconds) // self._lines)
        self.width_hz = self._lines / seconds
        lines, common = self._lines, (self._lines - 1) * _NEXT + (self._lines - 2) * _NEXT_BUT_ONE
        self._independent = 2.0 * lines**2 / (lines + 2.0 * common)
        window = np.hanning(values)
        self._window = window / np.sqrt(np.sum(window**2) * values)

    def spectrum(self, x: Array) -> Complex:
        """Lines (bands, lines) of `x` (n,): the sum of their squares is its mean square, one sided."""
        found = np.sqrt(2.0) * np.fft.rfft(self._window * x)
        return np.asarray(found[: self.count * self._lines].reshape(self.count, self._lines))

    def power(self, x: Array) -> Array:
        """Mean square (bands,) of `x` (n,)."""
        return np.asarray(np.sum(np.abs(self.spectrum(x)) ** 2, axis=1))

    def confidence(self, power: Array, spread: Array, parts: int) -> Array:
        """Share (bands,), 0 to 1, of the mean of `parts` parts that repeats, of its `power` and the `spread`."""
        if parts < 2:
            return np.zeros(len(power))
        one = self._independent
        own = one * (parts - 1)
        # the median of chi square lies below its mean
        about = median_filter(spread, _ABOUT, mode="reflect") / (1.0 - 2.0 / (9.0 * own)) ** 3
        beyond, itself = _times(power * parts, about), _times(power * parts, spread)
        sure = beyond > fisher.isf(_CHANCE / max(1, len(power)), one, _OF_THEM * own)
        sure &= itself > fisher.isf(_OWN_CHANCE, one, own)
        return np.asarray(np.where(sure, 1.0 - 1.0 / np.maximum(np.minimum(beyond, itself), 1.0), 0.0))

    def gain(self, share: Array, hertz: Array) -> Array:
        """`share` (bands,) at `hertz` (n,): whole in its band, so that a line near an end is, and falling beside it."""
        place = hertz / self.width_hz
        band = np.floor(place).astype(int)
        into = place - band
        padded = np.concatenate([np.zeros(1), share, np.zeros(2)])
        below, own, above = (padded[np.clip(band + k, 0, self.count + 1)] for k in (0, 1, 2))
        return np.asarray(np.maximum(own, np.maximum(below * (1.0 - 2.0 * into), above * (2.0 * into - 1.0))))

    def named(self, share: Array) -> tuple[tuple[float, float], ...]:
        """From and to (Hz) of the bands in a row of which something is taken."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], share > 0.0, [0]])))
        return tuple((float(low * self.width_hz), float(high * self.width_hz)) for low, high in edges.reshape(-1, 2))


def _times(power: Array, floor: Array) -> Array:
    """How many times its `floor` (bands,) a `power` is; infinite above none, 0 where both are."""
    nothing = np.where(power > 0.0, np.inf, 0.0)
    return np.asarray(np.divide(power, floor, out=nothing, where=floor > 0.0))


GRID_HZ = 1000.0
"""A memory has about so many values a second."""
_PASSED = 0.25
"""Of the grid's rate, where the low pass before it has its corner."""
_MOST_MISSED, _MOST_LIMITED = 0.05, 0.001
SETTLED_S, BEYOND_S = 0.5, 0.1
"""So long the loop tracks before a part that is learned from, and has settled; and after it: the tracker is late, and
the low pass sees beyond both ends."""


@dataclass(frozen=True)
class Part:
    """One axis during one part, `rate_hz` values (n,) a second, um."""

    rate_hz: float
    path_um: Array
    error_um: Array
    played_um: Array


def part_of(
    rows: NDArray[Any], axis: int, begun: int, seconds: float, period_s: float, range_V: tuple[float, float]
) -> Part:
    """The part of `seconds` that began in cycle `begun`, of the axis with that number.

    `rows` (n,) have the columns of telemetry; the cell tracks in all of them, to `BEYOND_S` after the part. CheckFailed
    where nothing can be learned from it.
    """
    own, cycles = rows["axis"][:, axis], rows["cycle"].astype(np.int64)
    if begun - cycles[0] < round(SETTLED_S / period_s):
        raise CheckFailed(f"it began less than {SETTLED_S:g} s after tracking had")
    time_s = (rows["time_ns"] - rows["time_ns"][0]) * 1e-9
    begin_s = float(begun - cycles[0]) * period_s
    within = (cycles >= begun) & (cycles < begun + round(seconds / period_s))
    _require_good(own["voltage_V"][within], range_V, 1.0 - np.count_nonzero(within) / round(seconds / period_s))
    fresh = (own["fresh"].astype(int) & DEVIATION_FRESH) != 0
    # one sample may come twice over a bus
    taken_s, first = np.unique((time_s - own["deviation_age_ns"] * 1e-9)[fresh], return_index=True)
    if len(taken_s) < 2:
        raise CheckFailed("no samples of the tracker came")
    path = CubicSpline(taken_s, own["deviation_um"][fresh][first])
    step = max(1, round(1.0 / (GRID_HZ * period_s)))
    rate_hz = 1.0 / (step * period_s)
    count, beyond = round(seconds * rate_hz), round(BEYOND_S * rate_hz)
    grid = begin_s + np.arange(-beyond * step, (count + beyond) * step) * period_s

    def thinned(x: Array) -> Array:
        passed = filtered(x, 1.0 / period_s, partial(low_pass, corner_hz=_PASSED * rate_hz))
        return passed[::step][beyond : beyond + count]

    # differences first: both sides of them move far while cycles are missed, and they hardly
    error, played = (
        thinned(np.interp(grid, time_s, each)) for each in (path(time_s) - own["stage_um"], own["learned_um"])
    )
    return Part(rate_hz, thinned(path(grid)), error, played)


def _require_good(voltage: Array, range_V: tuple[float, float], missed: float) -> None:
    if missed > _MOST_MISSED:
        raise CheckFailed(f"{100 * missed:.1f} % of its cycles were missed, at most {100 * _MOST_MISSED:g} % may be")
    limited = float(np.mean((voltage <= range_V[0]) | (voltage >= range_V[1])))
    if limited > _MOST_LIMITED:
        raise CheckFailed(
            f"the voltage was at an end of its range for {100 * limited:.2g} % of it; `micromanip analyse path` says "
            "where the path asks for more than there is"
        )
