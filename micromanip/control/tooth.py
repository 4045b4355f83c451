"""Parameters for following the tooth's frequency: the loop's gains, the filter without the tooth, poles over the range.

The law is ``rt/laws/frequency_lock.py``. Matrices are those of ``outer_gains``, whose last two states are the
oscillator's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .gain_schedule import intermittent_gains
from .outer_gains import Matrix, OuterGains, stationary_filter

if TYPE_CHECKING:
    from micromanip.settings.schema.axis import Outer

_DAMPED, _LEAST_DAMPED, _PULLS_IN_PER_S = 0.5, 4.0, 2.0
"""Share of the lead that is taken up, over the share of the error that a sample removes: a damping of .7. Of a slow
oscillator more, as much as finds a frequency within half a second, but no less damping than .25."""
_FORGOTTEN = 5.0
_FLOOR_SIGMA = 4.0
_WINDOW_S, _ACROSS_S, _FADE_S = 1.0, 1.0, 0.05
"""Window of the judgement; shortest time from one end of the range to the other; fading of dropped states."""
_PLACES = np.linspace(-1.0, 1.0, 9)


@dataclass(frozen=True)
class FollowedTooth:
    """Angles in rad a cycle, `slew` of them a sample; `plain` (gaps, n) are gains of the filter without the tooth."""

    place: int
    share: float
    turn: float
    range: float
    slew: float
    floor_um2: float
    shown: Matrix
    window: int
    patience: int
    fade: float
    plain: Matrix


def followed_tooth(outer: Outer, gains: OuterGains, gaps: int, period_s: float) -> FollowedTooth:
    """Figures of the law for the filter `gains` of `outer`, which has an oscillator."""
    assert outer.oscillation_Hz is not None
    m, n = gains.sample_cycles, len(gains.A)
    turn = 2.0 * math.pi * outer.oscillation_Hz * period_s
    reach = 0.01 * outer.oscillation_range_percent * turn
    P, sample_s = gains.covariance, m * period_s
    bare = _without_tooth(outer.without_tooth(), gains)
    plain = np.zeros((gaps, n))
    plain[:, : n - 2] = intermittent_gains(bare, gaps)
    error = removed(gains)
    window = max(1, round(_WINDOW_S / sample_s))
    return FollowedTooth(
        place=n - 2,
        share=max(_DAMPED * error, min(_LEAST_DAMPED * error, _PULLS_IN_PER_S * sample_s)) / m,
        turn=turn,
        range=reach,
        slew=2.0 * reach * sample_s / _ACROSS_S,
        floor_um2=_FLOOR_SIGMA**2 * float(P[-1, -1] + P[-2, -2]),
        shown=shown_without(gains, bare.observer),
        window=window,
        patience=1 + math.ceil(_FORGOTTEN / (error * window)),
        fade=math.exp(-period_s / _FADE_S),
        plain=plain,
    )


def turned(gains: OuterGains, angle: float) -> OuterGains:
    """The gains as they are, around a model whose oscillator turns by `angle` (rad) more in a cycle."""
    cos, sin = math.cos(angle), math.sin(angle)
    A = gains.A.copy()
    A[-2:, -2:] = np.array([[cos, sin], [-sin, cos]]) @ gains.A[-2:, -2:]
    return replace(gains, A=A)


def followed_radius(outer: Outer, gains: OuterGains, period_s: float) -> float:
    """Largest pole of the closed loop over the range that is followed, and of the one without the tooth."""
    assert outer.oscillation_Hz is not None
    reach = 2.0 * math.pi * outer.oscillation_Hz * period_s * 0.01 * outer.oscillation_range_percent
    held = [turned(gains, share * reach) for share in _PLACES] + [_without_tooth(outer.without_tooth(), gains)]
    return max(float(np.abs(each.closed_loop_poles).max()) for each in held)


def removed(gains: OuterGains) -> float:
    """Share of the oscillator's error that a sample removes: 1 less the radius of its pole."""
    sampled = np.linalg.matrix_power(gains.A, gains.sample_cycles)
    poles = np.linalg.eigvals((np.eye(len(gains.A)) - np.outer(gains.observer, gains.C)) @ sampled)
    own = np.linalg.eigvals(np.linalg.matrix_power(gains.A[-2:, -2:], gains.sample_cycles))
    nearest = poles[np.argmin(np.abs(poles - own[0]))]
    return float(max(0.0, 1.0 - abs(nearest)))


def shown_without(gains: OuterGains, observer: Matrix) -> Matrix:
    """How the oscillator (2,) shows in the innovation of a filter without it, whose gain is `observer` (n - 2,).

    That filter's error at a sample follows the oscillator, ``M o``: its remainder after a sample, m cycles later, plus
    the oscillator's effect meanwhile equal it again, ``M R^m = A^m (I - L C) M + sum A^(m-1-j) a R^j``.
    """
    A, a, R, m = gains.A[:-2, :-2], gains.A[:-2, -2:], gains.A[-2:, -2:], gains.sample_cycles
    pushed, moved, rotated = np.zeros_like(a), np.eye(len(A)), np.eye(2)
    for _ in range(m):
        pushed = A @ pushed + a @ rotated
        moved, rotated = A @ moved, R @ rotated
    left = moved @ (np.eye(len(A)) - np.outer(observer, gains.C[:-2]))
    equations = np.kron(np.eye(len(A)), rotated.T) - np.kron(left, np.eye(2))
    error = np.linalg.solve(equations, pushed.ravel()).reshape(len(A), 2)
    return np.asarray(gains.C[:-2] @ error, dtype=np.float64)


def _without_tooth(outer: Outer, gains: OuterGains) -> OuterGains:
    """The regulator of `gains` behind the filter of `outer`, which is the same but for the oscillator."""
    n = len(gains.A) - 2
    A, C = gains.A[:n, :n], gains.C[:n]
    bare = replace(gains, A=A, C=C, **stationary_filter(outer, A, C, gains.controllable)._asdict())
    return replace(bare, **{name: getattr(gains, name)[:n] for name in ("B", "feedback", "steady_u", "steady_y")})
