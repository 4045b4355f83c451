"""Describing function by quadrature, equations (18)-(21): any shaping, any offset, model and inverse.

The integrands are analytic between the angles at which a play begins to move or a table has a corner; the period
is split there and each piece integrated by Gauss-Legendre, so that the error is that of rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .operator import Array, Operator

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True)
class Harmonics:
    """Mean ``v0`` (18) and gain ``N = (a1 + i b1)/A`` (21) of the response to ``x0 + A sin``.

    ``headroom`` is the distance of the plays' sum to the end of phi's range, as a share of half that range: 1 in its
    middle, 0 at the end, where a tanh shaping can't be inverted any more (v0 and N are nan there); 1 without limits.
    """

    v0: float
    gain: complex
    headroom: float


def harmonics(operator: Operator, amplitude: float, centre: float = 0.0) -> Harmonics:
    """Harmonics of `operator` for the input ``centre + amplitude sin``, in the steady state after a start by (3)."""
    if not (np.isfinite(amplitude) and amplitude > 0 and np.isfinite(centre)):
        raise ValueError(f"the amplitude must be positive and finite, the offset finite, not {amplitude}, {centre}")
    u_low, u_high, w_low, w_high = operator.swing(centre, amplitude)
    ends = operator.total(np.array([u_low, u_high]), np.array([w_low, w_high]))
    headroom = _headroom(ends, operator.u_limits)
    if headroom <= 0.0:
        return Harmonics(np.nan, complex(np.nan, np.nan), headroom)
    mean = a1 = b1 = 0.0
    for rising, w0, start in ((True, w_low, u_low), (False, w_high, u_high)):
        edges = _edges(operator, amplitude, centre, rising, start, w0)
        half = 0.5 * np.diff(edges)[:, None]
        angle = (edges[:-1, None] + half * (1.0 + _NODES)).ravel()
        weight = (half * _WEIGHTS).ravel()
        y = operator.after(_branch(operator, operator.before(centre + amplitude * np.sin(angle)), rising, w0))
        mean += float(weight @ y)
        a1 += float(weight @ (y * np.sin(angle)))
        b1 += float(weight @ (y * np.cos(angle)))
    return Harmonics(mean / (2.0 * np.pi), complex(a1, b1) / (np.pi * amplitude), headroom)


def _branch(operator: Operator, u: Array, rising: bool, w0: Array) -> Array:
    """Sum of the plays at `u` (k,) on the branch that leaves the plays' outputs `w0` (n,)."""
    r = operator.thresholds
    moved = np.maximum(u[:, None] - r, w0) if rising else np.minimum(u[:, None] + r, w0)
    return operator.total(u, moved)


def _edges(operator: Operator, amplitude: float, centre: float, rising: bool, start: float, w0: Array) -> Array:
    """Angles at which a piece of the branch begins or ends, rising: -pi/2..pi/2 and falling: pi/2..3pi/2."""
    turns = w0 + operator.thresholds if rising else w0 - operator.thresholds
    inputs = operator.before_inverse(turns)
    if operator.inverse and len(operator.knots):
        # on a branch the plays' sum is a polyline in u that rises or falls steadily: invert it between its corners
        end = centre + amplitude if rising else centre - amplitude
        corners = np.sort(np.concatenate([[start, end], turns[(turns - start) * (turns - end) < 0]]))
        heights = _branch(operator, corners, rising, w0)
        inside = operator.knots[(operator.knots > heights[0]) & (operator.knots < heights[-1])]
        inputs = np.concatenate([inputs, np.interp(inside, heights, corners)])
    else:
        inputs = np.concatenate([inputs, operator.knots])
    sine = (inputs - centre) / amplitude
    angles = np.arcsin(sine[np.abs(sine) < 1.0])
    ends = np.array([-0.5, 0.5]) * np.pi
    edges = np.unique(np.concatenate([ends, angles]))
    return edges if rising else np.pi - edges[::-1]


def _headroom(ends: Array, limits: tuple[float, float]) -> float:
    low, high = limits
    if not np.isfinite(low):
        return 1.0
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    return float(1.0 - np.abs(ends - middle).max() / half)
