"""What a column of time says: even, with samples missing, rounded, jittering."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from .table import Array

_EVEN = 0.01
"""Share of the sampling interval that a step may differ from a whole number of them."""
_RAGGED = 0.5
"""Rms jitter, in sampling intervals, beyond which no rate is taken to be meant."""
_GAP = 1.5
"""Intervals from which on a step is a gap, not jitter."""
_PERIODS_S, _BITS, _LATE = (43_200.0, 86_400.0), (8, 10, 12, 16, 24, 32), 5.0
"""When clocks and counters begin anew, and how many intervals later at most the next sample comes."""
_SPREAD, _ENDS, _UNKNOWN = 1.5, 30, 0.05
"""Digits by which rounded times may be off an even clock; stamps at either end by which it is told, to this share."""


@dataclass(frozen=True)
class Clock:
    """Sampling interval, and the number of each sample (n,) on that grid, rising; missing ones are left out.

    `jittered`: the samples lie beside the grid, by the times (n,) in `seconds` from the first, and must be resampled.
    """

    step_s: float
    index: NDArray[np.int64]
    seconds: Array
    jittered: bool
    notes: tuple[str, ...]


def even(index: NDArray[np.int64], step_s: float, *notes: str) -> Clock:
    """The clock of rows of the numbers `index` (n,) on a grid."""
    return Clock(step_s, index, np.asarray(index * step_s, dtype=float), False, notes)


def read_clock(
    name: str, t: Array, where: Callable[[int], str], *, any_rate: bool = False, step_s: float | None = None
) -> Clock:
    """The clock that the finite times `t` (n,), s, describe; `where` puts the number of a row into words.

    With `any_rate` times that only rise will do; `step_s` is taken where they are too coarse to tell it from another.
    CheckFailed for times that don't rise, or have no rate.
    """
    if len(t) < 2:
        raise CheckFailed(f"{where(0)}: 1 sample is too few; record at least 200")
    t = t - t[0]
    steps = np.diff(t)
    if (clock := _rounded(name, t, steps, where, step_s)) is not None:
        return clock
    falls = np.flatnonzero(steps <= 0)
    if len(falls):
        k = int(falls[0])
        what = "stands still" if steps[k] == 0 else f"falls by {-steps[k]:.6g} s"
        often = f" ({len(falls)} of {len(steps)} steps do not rise)" if len(falls) > 1 else ""
        raise CheckFailed(
            f"{where(k + 1)}: {name} {what} here{often}; a time column rises with every sample: name another with "
            "--time, cut the file there, or take its rows as even, --time none --dt SECONDS"
        )
    return _rising(name, t, steps, where, any_rate)


def unwrapped(name: str, t: Array, unit_s: float, where: Callable[[int], str]) -> tuple[Array, list[str]]:
    """Times (n,) in `unit_s` that go on where a day, or a counter of some bits, begins anew; and what is told of it.

    As they are where they fall otherwise.
    """
    rows = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[rows])
    falls = steps < 0.0
    if not falls.any() or not np.any(steps > 0.0):
        return t, []
    periods = [seconds / unit_s for seconds in _PERIODS_S]
    periods += [2.0**bits for bits in _BITS if np.all(t[rows] == np.rint(t[rows]))]
    late = _LATE * float(np.median(steps[steps > 0.0]))
    for period in periods:
        behind = steps[falls] + period
        if np.ptp(t[rows]) < period and np.all((behind > 0.0) & (behind < late)):
            on = t.copy()
            on[rows[1:]] += period * np.cumsum(falls)
            often = f", {falls.sum()} times, first" if falls.sum() > 1 else ""
            place = where(int(rows[1:][falls][0]))
            return on, [f"{name} begins anew{often} at {place}: counted on from {period:.10g}"]
    return t, []


def _rising(name: str, t: Array, steps: Array, where: Callable[[int], str], any_rate: bool) -> Clock:
    step = float(np.median(steps))
    counts = np.maximum(np.rint(steps / step), 1.0)
    if np.abs(steps - counts * step).max() <= _EVEN * step * max(1.0, float(counts.max()) * 0.01):
        index = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        step = float(t[-1]) / float(index[-1])
        at, missing = np.flatnonzero(np.diff(index) > 1), int(index[-1]) + 1 - len(index)
        return even(index, step, *([_missing(name, [where(int(k) + 1) for k in at], missing)] if missing else []))
    step = float(np.mean(steps[steps <= _GAP * step])) if np.any(steps <= _GAP * step) else step
    ordinary = steps <= _GAP * step
    jitter = float(np.std(steps[ordinary])) / step
    if (jitter > _RAGGED or np.mean(ordinary) < 0.9) and not any_rate:
        raise CheckFailed(
            f"{where(1)}: {name} has no rate: its steps go from {steps.min():.4g} to {steps.max():.4g} s; "
            "record at a fixed rate, or choose one with --resample"
        )
    # a gap is a place that no sample is near to; a late sample is none
    counts = np.where(ordinary, 0.0, np.maximum(np.rint(steps / step), 2.0))
    index = np.rint(t / step).astype(np.int64)
    note = f"{name} jitters by {100 * jitter:.2g} % rms of {step:.6g} s: resampled evenly"
    gaps = np.flatnonzero(counts > 2.0)
    told = (_missing(name, [where(int(k) + 1) for k in gaps], int(np.sum(counts[gaps] - 1))),) if len(gaps) else ()
    return Clock(step, index, t, True, (note, *told))


def _rounded(name: str, t: Array, steps: Array, where: Callable[[int], str], step_s: float | None) -> Clock | None:
    """The clock of times that are even, but for their last digit; None where they are not.

    A stamp that begins with one row and another that does bound the interval: the rows between them are known to one.
    """
    positive = steps[steps > 0]
    if len(positive) in (0, len(steps)) or np.any(steps < 0):
        return None
    digit = float(positive.min())
    whole = np.abs(t / digit - np.rint(t / digit)).max() < 1e-3
    uneven = np.abs(steps - np.median(steps)).max() > _EVEN * float(np.median(steps))
    if not whole or not uneven or digit < _EVEN * float(np.median(steps)):
        return None
    begins = np.flatnonzero(steps > 0) + 1
    low, high = _bounds(begins, t[begins])
    step = 0.5 * (low + high) if np.isfinite(high) else float(t[-1]) / len(steps)
    if np.ptp(t - np.arange(len(t)) * step) > _SPREAD * digit:
        return None
    if step_s is not None and low * (1.0 - _EVEN) < step_s < high * (1.0 + _EVEN):
        step, known = step_s, ", as given"
    elif not high - low < _UNKNOWN * step:
        raise CheckFailed(
            f"{where(0)}: {name} is rounded to {digit:.3g} s, and too few of these are in it to tell the rate of "
            f"{len(t)} samples: give it, --time none --dt SECONDS"
        )
    else:
        known = f", known to {max(50.0 * (high - low) / step, 1e-4):.1g} %"
        step = _roundest(low, high)
    note = f"{name} is rounded to {digit:.3g} s: taken as even, {len(t)} samples every {step:.6g} s{known}"
    return even(np.arange(len(t)), step, note)


def _bounds(rows: NDArray[np.int64], stamps: Array) -> tuple[float, float]:
    """The least and the largest interval with which `stamps` (m,) begin at `rows` (m,): 0 and infinity for one."""
    early, late = slice(None, _ENDS), slice(-_ENDS, None)
    count = rows[late][:, None] - rows[early][None, :]
    seconds = stamps[late][:, None] - stamps[early][None, :]
    apart = count > 1
    if not apart.any():
        return 0.0, np.inf
    low = float((seconds[apart] / (count[apart] + 1)).max())
    high = float((seconds[apart] / (count[apart] - 1)).min())
    return min(low, high), max(low, high)


def _roundest(low: float, high: float) -> float:
    """The interval of fewest digits, its own or those of its rate, between two; their middle where none is there."""
    middle = 0.5 * (low + high)
    for digits in range(1, 8):
        for candidate in (float(f"{middle:.{digits}g}"), 1.0 / float(f"{1.0 / middle:.{digits}g}")):
            if low <= candidate <= high:
                return candidate
    return middle


def _missing(name: str, places: list[str], missing: int) -> str:
    samples = "1 sample is" if missing == 1 else f"{missing} samples are"
    gaps = f", in {len(places)} gaps, the first" if len(places) > 1 else ""
    return f"by {name} {samples} missing{gaps} before {places[0]}: not filled in, what is on either side is kept apart"
