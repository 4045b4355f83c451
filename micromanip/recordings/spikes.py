"""Samples that are wrong by themselves: spikes of a few samples; and what looks like them and is no fault.

A blow of a hammer lasts no longer than a spike, and its answer stands out as one. But the answer can be foretold: by an
autoregression with inputs, ``y[k] = sum a_i y[k-i] + sum b_i u[k-i] + c``, fitted to the record with all that is in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .table import Array

Flags = NDArray[np.bool_]

_WINDOW = 7
"""Samples of the running median: a spike of up to three samples stands out of it."""
_DEVIATIONS, _OTHERS, _SPAN = 12.0, 4.0, 0.01
"""A spike is so many standard deviations of what the median leaves, so many times what it leaves elsewhere (its
quantile `_USUAL`), and that share of the signal's span away."""
_USUAL = 0.97
_MOST = 0.02
"""More than this share of all samples are no spikes, but how the signal is."""
_LAGS, _AROUND, _MOST_ROWS, _ROUNDS = 10, 500, 100_000, 3
_FORETOLD, _BETTER, _UNUSUAL = 0.2, 0.99, 9.0
"""What is left of spikes that are an answer, of their mean square; of an autoregression's by bridging true spikes; how
many times its median error a fault is at least."""


def off_median(x: Array) -> Array:
    """How far each sample (n,) is from the median of those around it."""
    return np.asarray(np.abs(x - _median(x)))


def find_spikes(x: Array) -> Flags:
    """Samples (n,) of a signal `x` (n,) that leave it for up to three samples and come back.

    A signal that jumps often by itself (a binary sequence, noise) has none: nothing in it is unusual; nor is what it
    begins or ends with, which may be how it came there.
    """
    away = off_median(x)
    scale = float(np.median(away)) / 0.6745
    steps = np.abs(np.diff(x))
    finest = float(steps[steps > 0].min()) if np.any(steps > 0) else 0.0
    low, high = np.quantile(x, [0.005, 0.995])
    usual = float(np.quantile(away, _USUAL))
    limit = max(_DEVIATIONS * max(scale, finest), _OTHERS * usual, _SPAN * float(high - low))
    found = away > limit
    # those beside a spike have it in their median: once more without it
    around = _median(bridged(x, np.asarray(found)))
    found &= np.abs(x - around) > limit
    if finest == 0.0 or scale == 0.0 == usual or np.mean(found) > _MOST:
        return np.zeros(len(x), dtype=bool)
    rest = np.flatnonzero(~found)
    found[: rest[0]] = found[rest[-1] :] = False
    return np.asarray(found)


def faults_only(values: Array, flags: Flags, inputs: int) -> Flags:
    """Those of `flags` (n, k) that are faults: neither the answer of an output to inputs, nor what outputs answer.

    The first `inputs` columns of `values` (n, k) are inputs, the others outputs.
    """
    outputs = range(inputs, values.shape[1])
    around = np.ones(min(2 * _AROUND + 1, len(flags)))
    rows = np.flatnonzero(np.convolve(flags.any(axis=1), around, "same") > 0.5)
    rows = rows[rows >= _LAGS][:_MOST_ROWS]
    if len(rows) < 5 * _LAGS * values.shape[1]:
        return flags
    smooth = np.column_stack([bridged(column, flag) for column, flag in zip(values.T, flags.T, strict=True)])
    faults = np.zeros_like(flags)
    for _ in range(_ROUNDS):
        clean = np.where(faults, smooth, values)
        laws = [_law(_lagged(clean, inputs, j, rows), clean[rows, j]) for j in outputs]
        found = faults.copy()
        for k in range(values.shape[1]):
            for first, last in runs(flags[:, k]):
                begin, end = first - _LAGS, min(last + (_LAGS if k < inputs else 0), len(values))
                if begin < 0:
                    continue
                judged = outputs if k < inputs else [k]
                left = []
                for each in (values, smooth):
                    piece = clean[begin:end].copy()
                    piece[_LAGS : last - begin, k] = each[first:last, k]
                    left.append(sum(_left(piece, inputs, j, *laws[j - inputs][:2]) for j in judged))
                if k < inputs:
                    found[first:last, k] = left[1] < _BETTER * left[0]
                else:
                    away = (values[first:last, k] - smooth[first:last, k]) / laws[k - inputs][1]
                    least = (last - first) * laws[k - inputs][2]
                    found[first:last, k] = left[0] > max(_FORETOLD * np.sum(away**2), least)
        faults = found
    return faults


def _lagged(values: Array, inputs: int, output: int, rows: NDArray[np.int64]) -> Array:
    """What an output is foretold from at `rows` (n,): its past, the inputs' past and now, and 1."""
    own = [values[rows - lag, output] for lag in range(1, _LAGS + 1)]
    driven = [values[rows - lag, k] for k in range(inputs) for lag in range(_LAGS + 1)]
    return np.column_stack([*own, *driven, np.ones(len(rows))])


def _law(table: Array, target: Array) -> tuple[Array, float, float]:
    """Weights by least squares, the target's size, by which errors are measured, and the least unusual square."""
    size = np.maximum(np.abs(table).max(axis=0), 1e-300)
    weights = np.linalg.lstsq(table / size, target, rcond=None)[0] / size
    spread = max(float(np.std(target)), 1e-300)
    return weights, spread, (_UNUSUAL * float(np.median(np.abs(target - table @ weights))) / spread) ** 2


def _left(piece: Array, inputs: int, output: int, law: Array, size: float) -> float:
    """Square sum of what a law leaves of an output in a piece (n, k) of the record, behind its first lags."""
    rows = np.arange(_LAGS, len(piece))
    error = piece[rows, output] - _lagged(piece, inputs, output, rows) @ law
    return float(np.sum((error / size) ** 2))


def runs(flags: Flags) -> list[tuple[int, int]]:
    """First and last but one of each run of `flags` (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.view(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def bridged(x: Array, flags: Flags) -> Array:
    """`x` (n,) with straight lines over the samples that are flagged."""
    if not flags.any() or flags.all():
        return x
    at = np.arange(len(x))
    return np.where(flags, np.interp(at, at[~flags], x[~flags]), x)


def _median(x: Array) -> Array:
    """The running median; scipy is loaded with the first: who only writes recordings does without."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(x, _WINDOW, mode="nearest"), float)
