"""What a column of time says of a recording: even, with samples missing, rounded, jittering, or of no use."""

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
_HOUR_S, _FASTEST_HZ = 3600.0, 2e6


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


def even(samples: int, step_s: float) -> Clock:
    """The clock of a recording without a column of time."""
    index = np.arange(samples)
    return Clock(step_s, index, np.asarray(index * step_s, dtype=float), False, ())


def read_clock(name: str, t: Array, where: Callable[[int], str], *, any_rate: bool = False) -> Clock:
    """The clock that the times `t` (n,), s, describe; `where` puts the number of a row into words.

    With `any_rate` times that only rise will do. CheckFailed for times that don't rise, or have no rate.
    """
    bad = np.flatnonzero(~np.isfinite(t))
    if len(bad):
        raise CheckFailed(f"{where(int(bad[0]))}: the time column {name} has no number here")
    if len(t) < 2:
        raise CheckFailed(f"{where(0)}: 1 sample is too few; record at least 200")
    t = t - t[0]
    steps = np.diff(t)
    rounding = _rounding(t, steps)
    if rounding is not None:
        step = float(t[-1]) / len(steps)
        note = f"{name} is rounded to {rounding:.3g} s: taken as even, {len(t)} samples every {step:.6g} s"
        return Clock(step, np.arange(len(t)), np.linspace(0.0, float(t[-1]), len(t)), False, (note,))
    falls = np.flatnonzero(steps <= 0)
    if len(falls):
        k = int(falls[0])
        what = "stands still" if steps[k] == 0 else f"falls by {-steps[k]:.6g} s"
        raise CheckFailed(
            f"{where(k + 1)}: {name} {what} here; a time column rises with every sample: name another with --time, "
            "or cut the file there"
        )
    return _rising(name, t, steps, where, any_rate)


def _rising(name: str, t: Array, steps: Array, where: Callable[[int], str], any_rate: bool) -> Clock:
    step = float(np.median(steps))
    counts = np.maximum(np.rint(steps / step), 1.0)
    if np.abs(steps - counts * step).max() <= _EVEN * step * max(1.0, float(counts.max()) * 0.01):
        index = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        step = float(t[-1]) / float(index[-1])
        return Clock(step, index, np.asarray(index * step, dtype=float), False, _gaps(name, index, where))
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


def _rounding(t: Array, steps: Array) -> float | None:
    """The last digit of times that are an even clock, rounded; None where they are not."""
    positive = steps[steps > 0]
    if len(positive) in (0, len(steps)) or np.any(steps < 0):
        return None
    digit = float(positive.min())
    line = np.arange(len(t)) * float(t[-1]) / len(steps)
    if digit < _EVEN * float(np.median(steps)) or np.abs(t - line).max() > 1.01 * digit:
        return None
    whole = np.abs(t / digit - np.rint(t / digit)).max() < 1e-3
    uneven = np.abs(steps - np.median(steps)).max() > _EVEN * float(np.median(steps))
    return digit if whole and uneven else None


def _gaps(name: str, index: NDArray[np.int64], where: Callable[[int], str]) -> tuple[str, ...]:
    at = np.flatnonzero(np.diff(index) > 1)
    missing = int(index[-1]) + 1 - len(index)
    return (_missing(name, [where(int(k) + 1) for k in at], missing),) if missing else ()


def _missing(name: str, places: list[str], missing: int) -> str:
    samples = "1 sample is" if missing == 1 else f"{missing} samples are"
    gaps = f", in {len(places)} gaps, the first" if len(places) > 1 else ""
    return f"by {name} {samples} missing{gaps} before {places[0]}: not filled in, what is on either side is kept apart"


def doubts(name: str, samples: int, step_s: float) -> list[str]:
    """What in a clock without a stated unit looks like another unit."""
    length = samples * step_s
    if length > _HOUR_S and step_s > 0.05:
        return [
            f"by {name} the record lasts {length / 3600:.3g} h at {1 / step_s:.4g} Hz: if these are milliseconds, "
            f"give --time {name}:ms"
        ]
    if step_s < 1.0 / _FASTEST_HZ:
        return [f"by {name} it was sampled at {1e-6 / step_s:.3g} MHz: if these are seconds, give --time {name}:s"]
    return []
