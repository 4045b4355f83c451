"""What a share of the PID's gains makes of the gauge's noise and of what does not repeat: how far the position moves.

What repeats of a sine is taken off beforehand. What is left for the feedback is what does not, and it makes motion of
the gauge's noise itself. At rest, with the loop L, S = 1 / (1 + L), noise n of the gauge, disturbance d, position x,

    y = S (n + d),   x = S d - (1 - S) n,

so the gauge's spectrum at rest under one share says what n and d are (n is white, and all there is at 1 to 3 kHz,
where S is 1), and with them what the position does under any other share. Lines of the mains are taken for the gauge's
own. L is the PID, which is known, times what was measured from voltage to gauge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from micromanip.control.pid import pid_response
from micromanip.settings.schema.axis import Inner

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SHARES = (1.0, 0.25, 0.0625)
MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)
_BESIDE_HZ = 1.5
_FELT_HZ, _WHITE_HZ = 600.0, (1000.0, 3000.0)
"""Above the one no feedback does anything about a disturbance; in the other there is nothing but noise."""
_LEAST_MS = 1.6
"""A loop with such a peak of |S| may be taken, though that of all gains has a lower one."""


def sensitivity(share: float, loop: Complex) -> Complex:
    """S (n,) with `share` of the gains, of the `loop` L (n,) with all of them."""
    return np.asarray(1.0 / (1.0 + share * loop))


def loop_of(inner: Inner, period_s: float, hertz: Array, known_hz: Array, plant: Complex) -> Complex:
    """L (n,) at `hertz`, of what was measured at `known_hz` from voltage (V) to gauge (um); below them, the first."""
    return np.asarray(pid_response(inner, period_s, 2.0 * np.pi * hertz) * np.interp(hertz, known_hz, plant))


@dataclass(frozen=True)
class QuietLoop:
    """Of one axis: its loop (n,) with all gains at `hertz` (n,), evenly spaced, and its gauge's spectrum under them.

    `seen` (n,) is in um^2/Hz, the mean of so many `segments`.
    """

    hertz: Array
    loop: Complex
    seen: Array
    segments: int

    @classmethod
    def of(cls, hertz: Array, loop: Complex, resting_um: Array, rate_hz: float) -> QuietLoop:
        """The same, of the gauge at rest (m,)."""
        window = round(rate_hz / float(hertz[1] - hertz[0]))
        own_hz, power = welch(resting_um, rate_hz, "hann", window)
        return cls(hertz, loop, np.interp(hertz, own_hz, power), max(1, 2 * (len(resting_um) // window) - 1))

    def sensitivity(self, share: float, hertz: Array) -> Complex:
        """S (m,) at `hertz` (m,) with `share` of the gains."""
        return sensitivity(share, np.interp(hertz, self.hertz, self.loop))

    def motion_um2(self, share: float, learned_hz: Array) -> float:
        """Mean square of the position at rest with `share` of the gains, but for lines (m,) that are learned."""
        hertz, whole = self.hertz, self.seen / np.abs(sensitivity(1.0, self.loop)) ** 2
        inside = (hertz >= _WHITE_HZ[0]) & (hertz <= _WHITE_HZ[1])
        white = float(np.median(whole[inside])) / (1.0 - 1.0 / (9.0 * self.segments)) ** 3
        S = sensitivity(share, self.loop)
        mains = np.any(np.abs(hertz[:, None] - MAINS_HZ) <= _BESIDE_HZ, axis=1)
        followed = np.setdiff1d(MAINS_HZ, learned_hz)
        own = np.any(np.abs(hertz[:, None] - followed) <= _BESIDE_HZ, axis=1)
        felt = (hertz <= _FELT_HZ) & ~mains
        left = np.sum(np.abs(S[felt]) ** 2 * (whole[felt] - white))
        left += np.sum(np.abs(1.0 - S[own]) ** 2 * (whole[own] - white))
        return float((hertz[1] - hertz[0]) * (white * np.sum(np.abs(1.0 - S) ** 2) + left))

    def bears(self, share: float) -> bool:
        """Whether the loop is as stable with `share` of the gains as with all of them, and no nearer to its limit."""
        turned = _turn(share * self.loop) - _turn(self.loop)
        return round(turned / (2.0 * np.pi)) == 0 and _peak(share, self.loop) <= max(_LEAST_MS, _peak(1.0, self.loop))


def _turn(loop: Complex) -> float:
    phase = np.unwrap(np.angle(1.0 + loop))
    return float(phase[-1] - phase[0])


def _peak(share: float, loop: Complex) -> float:
    return float(np.abs(sensitivity(share, loop)).max())
