"""Fewer points for a picture of a curve, its peaks kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .model import Array

MOST_POINTS = 2000


def thinned(x: Array, y: Array, most: int = MOST_POINTS, log_x: bool = False) -> tuple[Array, Array]:
    """At most `most` (>= 20) of the points `x` (n,), `y` (n,), in their order.

    Where x never falls, the axis is cut into equal pieces as it is seen (equal in log x with `log_x`), and each
    piece keeps its lowest and its highest point: on paper the curve covers the same. Where x turns back
    (Nyquist, hysteresis), the pieces are parts of its way, and the extremes in x are kept as well. A gap (a point that
    is not finite) stays a gap. Short curves are returned as they are.
    """
    if len(x) <= most:
        return x, y
    shown = np.isfinite(x) & np.isfinite(y)
    if log_x:
        shown &= x > 0
    rises = bool(np.all(np.diff(x[shown]) >= 0))
    kinds = (y,) if rises else (x, y)
    pieces = (most - 2) // (2 * len(kinds) + (not shown.all()))
    position = _seen(x, shown, log_x) if rises else _along(x, y, shown)
    piece = _pieces(position, pieces)
    ends = np.flatnonzero(shown)[[0, -1]] if shown.any() else np.zeros(0, np.int64)
    kept = [_extremes(piece, values, shown) for values in kinds] + [_first(piece, np.flatnonzero(~shown)), ends]
    order = np.unique(np.concatenate(kept))
    return x[order], y[order]


def _seen(x: Array, shown: NDArray[np.bool_], log_x: bool) -> Array:
    """Place on the axis; that of what is not shown is where the point before it is."""
    if not shown.any():
        return np.arange(float(len(x)))
    last = np.maximum.accumulate(np.where(shown, np.arange(len(x)), np.argmax(shown)))
    return np.log(x[last]) if log_x else x[last]


def _along(x: Array, y: Array, shown: NDArray[np.bool_]) -> Array:
    """Way along the curve as it is seen, its whole size one; half of it is the number of the point.

    The way alone would leave the calm part of a curve that is mostly noise with hardly a point.
    """
    way = np.zeros(len(x))
    for values in (x, y):
        size = np.ptp(values[shown])
        step = np.abs(np.diff(values, prepend=values[0])) / (size if size > 0 else 1.0)
        way = np.hypot(way, np.where(np.isfinite(step), step, 0.0))
    travelled = np.cumsum(way)
    share: Array = travelled / max(travelled[-1], 1e-300) + np.linspace(0.0, 1.0, len(x))
    return share


def _pieces(position: Array, pieces: int) -> NDArray[np.int64]:
    """Number of the piece each position is in, 0..pieces-1."""
    span = position.max() - position.min()
    share = (position - position.min()) / span if span > 0 else np.linspace(0.0, 1.0, len(position))
    return np.minimum((share * pieces).astype(np.int64), pieces - 1)


def _extremes(piece: NDArray[np.int64], values: Array, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices of the lowest and the highest shown value of each piece."""
    candidates = np.flatnonzero(shown)
    order = candidates[np.lexsort((values[candidates], piece[candidates]))]
    edges = np.flatnonzero(np.diff(piece[order]))
    return np.concatenate((order[:1], order[edges], order[edges + 1], order[-1:]))


def _first(piece: NDArray[np.int64], indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first of `indices` in each piece."""
    return indices[np.unique(piece[indices], return_index=True)[1]]
