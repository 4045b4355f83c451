"""Whether an outer loop comes to rest from a swing of any size, where the set-point's slew limit binds.

Margins are of small signals. A set-point that runs at its slew limit lags by up to 90 degrees more, and a regulator
that is fast around a slow mode can then drive the mode instead of damping it: a blow, or some milliseconds in which the
loop stands still, and the stage swings for good. So each design is played: its model, with the mode swinging, under its
own filter and regulator, within slew limit and range, with samples as seldom and as late as they come. A limit cycle
may be small: swings from half of the reach down to where the slew limit no longer binds are played.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import OuterGains
from micromanip.rt.jit import Compiler
from micromanip.settings.schema.axis import Axis

compiled = Compiler(__file__, allocates=True)
Array = NDArray[Any]

_SHARES = 0.5 ** np.arange(1, 9)
"""Swings that must die out, in terms of what the set-point's reach moves the stage by."""
_LONGEST_S, _WINDOW_S, _RESTED = 1.0, 0.05, 0.05
"""Time that is played at most; its windows, of which each has a largest output; what is left of a swing that rests."""
_RAISED_S, _RAISED = 0.2, 0.1
"""A mode counts whose swing a set-point at its frequency raises in that time to this share of what it moves at rest."""
_SHRINKS, _LEFT = 0.9, 0.5
"""At the end a slow swing may be this share of what it was two windows before, and this share of the first, at most."""


@dataclass(frozen=True)
class Reach:
    """What the set-point can do: um in a cycle, and um to the nearer end of its range from the working point."""

    slew_um: float
    range_um: float

    @classmethod
    def of(cls, settings: Axis, period_s: float) -> Reach:
        """That of a configured axis."""
        low, high = settings.setpoint.range_um
        nearer = min(settings.centre_um - low, high - settings.centre_um)
        return cls(settings.setpoint.slew_um_per_ms * 1e3 * period_s, nearer)


@dataclass(frozen=True)
class Samples:
    """The stage sensor: one sample every so many cycles, seen so many cycles after it was taken."""

    cycles: int = 1
    late: int = 0


def comes_to_rest(gains: OuterGains, states: int, reach: Reach, period_s: float, samples: Samples = Samples()) -> bool:
    """Whether swings of the model's least damped mode die out, in its first `states`; True where it has none."""
    A, B, C, K = gains.A, gains.B, gains.C, gains.feedback
    entering = A[:states, gains.controllable]  # as the disturbance does: the set-point, its delay over
    static = float(C[:states] @ np.linalg.solve(np.eye(states) - A[:states, :states], entering))
    values, vectors = np.linalg.eig(A[:states, :states])
    seen = C[:states] @ vectors
    moved = seen * np.linalg.solve(vectors, entering.astype(complex))
    swinging = np.flatnonzero((values.imag > 0.0) & (_raised(values, moved, period_s) > _RAISED * abs(static)))
    if len(swinging) == 0:
        return True
    least = swinging[np.argmax(np.abs(values[swinging]))]
    vector = vectors[:, least] / seen[least]
    corrected = np.linalg.matrix_power(A, samples.late) @ gains.observer  # of now, by an innovation of then
    window = max(round(_WINDOW_S / period_s), 2 * samples.cycles)
    count = max(round(_LONGEST_S / _WINDOW_S), 4)
    for swing_um in _SHARES * abs(static) * reach.range_um:
        x = np.zeros(len(A))
        x[:states] = np.real(vector) * swing_um
        limits = reach.slew_um, reach.range_um
        peaks = _peaks(
            A, B, C, K, corrected, x, *limits, samples.cycles, samples.late, window, count, _RESTED * swing_um
        )
        rested = peaks[-1] <= _RESTED * swing_um
        if not (rested or (peaks[-1] <= _SHRINKS * peaks[-3] and peaks[-1] <= _LEFT * swing_um)):
            return False
    return True


def _raised(values: Array, moved: Array, period_s: float) -> Array:
    """Swing of each mode (n,) that a set-point of +-1 um at its frequency raises in `_RAISED_S`, or for ever, in um.

    Nobody can raise a pole with a zero upon it: it is the identification's, and no mode of the stage.
    """
    poles = np.log(values.astype(complex)) / period_s
    turn, decay = np.abs(poles.imag), np.maximum(-poles.real, 1.0 / _RAISED_S)
    raised: Array = np.abs(moved / (1.0 - values)) * turn / decay
    return raised


@compiled
def _peaks(
    A: Any, B: Any, C: Any, K: Any, L: Any, x: Any, slew_um: float, range_um: float, every: int, late: int, window: int,
    count: int, rested_um: float,
) -> Any:  # fmt: skip
    """Largest output of each of `count` windows, from the state `x` (n,), which the filter knows, until it rests.

    The filter takes the innovation of the sample's own time, and corrects the estimate of now by it.
    """
    size = len(x)
    estimate, later, other = x.copy(), np.empty(size), np.empty(size)
    innovations, peaks = np.zeros(late + 1), np.zeros(count)
    u = 0.0
    for k in range(count):
        for cycle in range(k * window, (k + 1) * window):
            y = expected = 0.0
            for i in range(size):
                y += C[i] * x[i]
                expected += C[i] * estimate[i]
            innovations[cycle % (late + 1)] = y - expected
            taken = cycle - late
            if taken >= 0 and taken % every == 0:
                for i in range(size):
                    estimate[i] += L[i] * innovations[taken % (late + 1)]
            wanted = 0.0
            for i in range(size):
                wanted -= K[i] * estimate[i]
            wanted = min(max(wanted, -range_um), range_um)
            u = min(max(wanted, u - slew_um), u + slew_um)
            for i in range(size):
                real = expected = B[i] * u
                for j in range(size):
                    real += A[i, j] * x[j]
                    expected += A[i, j] * estimate[j]
                later[i], other[i] = real, expected
            for i in range(size):
                x[i], estimate[i] = later[i], other[i]
            peaks[k] = max(peaks[k], abs(y))
        if peaks[k] <= rested_um:
            return peaks[: k + 1]
    return peaks
