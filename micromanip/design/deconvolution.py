"""Step response of a loop out of ordinary running: set-point and position, without a test signal.

The frequency response is H = S_uy / S_uu over windows of half a second (Hann, overlapping by a half), of differences,
so that slow strokes do not leak into what is fast; a Wiener weight takes off what the windows' scatter hides (as in
N. Wiener, Extrapolation, Interpolation and Smoothing of Stationary Time Series; Betaflight's PIDtoolbox does the same
with gyro and set-point). Its integral is the step response. The band is a jackknife over groups of windows that follow
one another.

What is said holds for the loop as it runs: where noise of the gauge comes back in the set-point by an outer loop, that
part is taken for response.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import hann
from scipy.stats import t as student

from .run_confidence import Array

Complex = NDArray[np.complex128]
Cycles = NDArray[np.int64]

WINDOW_S, SHOWN_S, _BEFORE_S = 0.5, 0.05, 0.002
"""The response is shown from `_BEFORE_S` before the step to `SHOWN_S` after it."""
_FEWEST, _GROUPS = 16, 16
"""Windows below which nothing is said; groups of the jackknife."""
_INDEPENDENT = 0.75
"""Of Hann windows that overlap by a half so many count, for white noise (Welch 1967)."""
_POOLED_HZ = 20.0
"""Over so much a response of 50 ms is smooth: lines are taken together where it is asked how sure they are."""
_SURE = 0.2
"""Relative error of H up to which a frequency counts as seen."""
_DARK = 1e-7
"""Power beside the strongest line's, below which the window's own leakage is what is seen."""
_LEAST_PERIODS = 3.0
_FADED = 0.3
_MOST_BRIDGED = 10
"""Cycles in a row that the loop skipped, or that were lost: longer gaps begin a new piece."""
_MOST_SUMS = 256
"""Of windows that follow one another; of a longer run more windows are summed in each."""


@dataclass(frozen=True)
class StepResponse:
    """`response` (n,) at `t_s` (n,) to a step of one, and its 95 % band; empty where there is a `problem`.

    `reach_Hz` is up to where the set-point lets one see: what is faster is smoothed. `is_whole` says that the loop
    itself has faded by then. `rise_ms` is from 10 to 90 %, `overshoot_percent` over the end of what is shown; each with
    the half width of its 95 % interval behind it.
    """

    t_s: Array
    response: Array
    low: Array
    high: Array
    reach_Hz: float
    is_whole: bool
    rise_ms: tuple[float, float]
    overshoot_percent: tuple[float, float]
    problem: str | None = None

    def document(self) -> dict[str, Any]:
        """Its figures as JSON."""
        return {
            "reach_Hz": self.reach_Hz,
            "is_whole": self.is_whole,
            "rise_ms": list(self.rise_ms) if self.problem is None else None,
            "overshoot_percent": list(self.overshoot_percent) if self.problem is None else None,
            "problem": self.problem,
        }


@dataclass(frozen=True)
class _Sums:
    """Power and cross spectra (f,) of some windows that follow one another, summed."""

    windows: int
    uu: Array
    yy: Array
    uy: Complex

    def with_(self, other: _Sums) -> _Sums:
        return _Sums(self.windows + other.windows, self.uu + other.uu, self.yy + other.yy, self.uy + other.uy)


def _nothing(problem: str, reach_Hz: float = 0.0) -> StepResponse:
    none = np.empty(0)
    return StepResponse(none, none, none, none, reach_Hz, False, (np.nan, np.nan), (np.nan, np.nan), problem)


class StepSpectra:
    """Spectra of a set-point and a position (um), taken while they are read: `add`, then `response`."""

    def __init__(self, rate_Hz: float) -> None:
        self._rate_Hz, self._count = rate_Hz, round(WINDOW_S * rate_Hz)
        self._rest: tuple[Cycles, Array, Array] = (np.empty(0, np.int64), np.empty(0), np.empty(0))
        self._sums: list[_Sums] = []
        self._each, self._windows = 1, 0

    def add(self, cycles: Cycles, u: Array, y: Array) -> None:
        """Rows (n,) that follow: those in which the axis tracks and both are known."""
        rest = [np.concatenate(both) for both in zip(self._rest, (cycles, u, y), strict=True)]
        stretches = list(_stretches(*rest))
        for stretch in stretches:
            self._take(*stretch)
        if stretches:
            grid, u, y = stretches[-1]
            begin = max(0, (len(u) - 1 - self._count) // self._step + 1) * self._step
            self._rest = grid[begin:], u[begin:], y[begin:]

    @property
    def _step(self) -> int:
        return self._count // 2

    def _take(self, _: Cycles, u: Array, y: Array) -> None:
        for U, Y in _windows(np.diff(u), np.diff(y), self._count):
            one = _Sums(1, np.abs(U) ** 2, np.abs(Y) ** 2, np.conj(U) * Y)
            self._windows += 1
            if self._sums and self._sums[-1].windows < self._each:
                self._sums[-1] = self._sums[-1].with_(one)
            else:
                self._sums.append(one)
            if len(self._sums) > _MOST_SUMS:
                last = self._sums[len(self._sums) // 2 * 2 :]
                self._sums = [a.with_(b) for a, b in zip(self._sums[::2], self._sums[1::2], strict=False)] + last
                self._each *= 2

    def response(self) -> StepResponse:
        """The step response, or why nothing is said of it."""
        return _response(self._sums, self._windows, self._count, self._rate_Hz)


def _stretches(cycles: Cycles, u: Array, y: Array) -> Iterator[tuple[Cycles, Array, Array]]:
    """Pieces without gaps; single missing cycles are drawn straight between their neighbours."""
    for part in np.split(np.arange(len(cycles)), np.flatnonzero(np.diff(cycles) > _MOST_BRIDGED) + 1):
        if len(part):
            grid = np.arange(cycles[part[0]], cycles[part[-1]] + 1)
            yield grid, np.interp(grid, cycles[part], u[part]), np.interp(grid, cycles[part], y[part])


def _response(sums: Sequence[_Sums], windows: int, count: int, rate_Hz: float) -> StepResponse:
    if windows < _FEWEST:
        needed = (_FEWEST + 1) / 2 * WINDOW_S
        return _nothing(f"too short to say: less than {needed:.2g} s of tracking in pieces of {WINDOW_S:g} s or more")
    groups = np.array_split(np.arange(len(sums)), min(_GROUPS, len(sums) // 2))
    S_uu, S_yy, S_uy = (
        np.array([np.sum([getattr(sums[k], name) for k in group], axis=0) for group in groups])
        for name in ("uu", "yy", "uy")
    )
    frequency = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_Hz), dtype=np.float64)
    error = _relative_error(S_uu.sum(axis=0), S_yy.sum(axis=0), S_uy.sum(axis=0), windows, frequency[1])
    reach_Hz = _reach(frequency, error)
    if reach_Hz * SHOWN_S < _LEAST_PERIODS:
        return _nothing(
            f"excited too weakly to say: the set-point moves it enough up to {reach_Hz:.0f} Hz, "
            f"{_LEAST_PERIODS / SHOWN_S:.0f} Hz are needed",
            reach_Hz,
        )
    weight = _weight(frequency, error, reach_Hz)

    def response(kept: Any) -> Array:
        return _integrated(S_uu[kept].sum(axis=0), S_uy[kept].sum(axis=0), weight, rate_Hz)

    everything = np.arange(len(groups))
    found, left_out = response(everything), np.array([response(everything != k) for k in everything])
    t_s = np.arange(len(found)) / rate_Hz - _BEFORE_S
    half = _jackknife(left_out)
    figures = [_figures(t_s, each) for each in (found, *left_out)]
    halves = _jackknife(np.array(figures[1:]))
    H = np.abs(_pooled(S_uy.sum(axis=0) / np.maximum(S_uu.sum(axis=0), np.finfo(float).tiny), frequency[1]))
    is_whole = bool(H[np.searchsorted(frequency, reach_Hz) - 1] < _FADED)
    (rise, over), (rise_half, over_half) = figures[0], halves
    return StepResponse(
        t_s, found, found - half, found + half, reach_Hz, is_whole,
        (float(rise), float(rise_half)), (float(over), float(over_half)),
    )  # fmt: skip


def _windows(u: Array, y: Array, count: int) -> Iterator[tuple[Complex, Complex]]:
    window = hann(count, sym=False)
    for first in range(0, len(u) - count + 1, count // 2):
        part = slice(first, first + count)
        yield np.fft.rfft(window * u[part]), np.fft.rfft(window * y[part])


def _pooled(values: NDArray[Any], step_Hz: float) -> NDArray[Any]:
    """Sums over neighbouring lines, as means."""
    width = 2 * round(_POOLED_HZ / step_Hz / 2) + 1
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def _relative_error(S_uu: Array, S_yy: Array, S_uy: Complex, windows: int, step_Hz: float) -> Array:
    """Standard error of H over |H|, of lines taken together (Bendat and Piersol, Random Data, 9.2)."""
    power = np.abs(S_uy) ** 2
    coherence = np.clip(_pooled(power / np.maximum(S_uu * S_yy, np.finfo(float).tiny), step_Hz), 1e-12, 1.0)
    independent = _INDEPENDENT * windows
    without = np.maximum(coherence - (1.0 - coherence) / independent, 1e-12)  # one comes of nothing but few windows
    lines = max(1.0, _POOLED_HZ / step_Hz / 1.5)  # a Hann window makes 1.5 lines one
    error = np.sqrt((1.0 - coherence) / (2.0 * without * independent * lines))
    return np.asarray(np.where(S_uu > _DARK * S_uu.max(), error, np.inf))


def _reach(frequency: Array, error: Array) -> float:
    """Up to where all frequencies are seen."""
    blind = np.flatnonzero(error[2:] > _SURE)
    return float(frequency[2 + blind[0]] if len(blind) else frequency[-1])


def _weight(frequency: Array, error: Array, reach_Hz: float) -> Array:
    """Wiener's, and a soft end where nothing is seen any more."""
    past = np.clip((frequency / reach_Hz - 0.6) / 0.4, 0.0, 1.0)
    end = 0.5 * (1.0 + np.cos(np.pi * past))
    return np.asarray(np.where(frequency < reach_Hz, end / (1.0 + np.where(np.isfinite(error), error, 0.0) ** 2), 0.0))


def _integrated(S_uu: Array, S_uy: Complex, weight: Array, rate_Hz: float) -> Array:
    H = S_uy / np.maximum(S_uu, np.finfo(float).tiny)
    H[0] = np.real(H[1:3].mean())  # differences say nothing of the mean
    impulse = np.fft.irfft(H * weight, 2 * (len(H) - 1))
    before, after = round(_BEFORE_S * rate_Hz), round(SHOWN_S * rate_Hz)
    return np.asarray(np.cumsum(np.roll(impulse, before)[: before + after]))


def _jackknife(left_out: Array) -> Array:
    """Half width of the 95 % interval of something that was found with each group (k, ...) left out."""
    count = len(left_out)
    spread = np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0))
    return np.asarray(student.ppf(0.975, count - 1) * spread)


def _figures(t_s: Array, response: Array) -> tuple[float, float]:
    """Time from 10 to 90 % (ms), and the overshoot (%), both of where it ends."""
    end = float(response[-len(response) // 5 :].mean())
    crossed = [
        float(np.interp(share * end, response[k - 1 : k + 1], t_s[k - 1 : k + 1]))
        for share in (0.1, 0.9)
        for k in [max(1, int(np.argmax(response >= share * end)))]
    ]
    return 1e3 * (crossed[1] - crossed[0]), 100.0 * (float(response.max()) / end - 1.0)
