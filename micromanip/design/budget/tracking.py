"""The tracker's predictor (``rt/laws/reference.py``) as a transfer from its samples to what the outer loop is given.

At a sample z the predictor's state is ``f+ = F(T) f + g (z - H F(T) f)``, in a cycle of age tau it gives
``w = F(tau) f``, of which the outer loop takes ``r = G w`` (``control/outer_gains.py``). T is `every` cycles h. A sample
train of spectrum Z(w) is at the loop's rate a train of spikes, whose spectrum is the same and periodic, behind

    R(w) = sum_j e^(-i w h j) G F(tau_0 + j h) (I - (I - g H) F(T) e^(-i w T))^-1 g,   j = 0 .. every - 1

(the polyphase identity; Vaidyanathan, Multirate Systems and Filter Banks, section 4.3). Between samples no noise
enters, so white noise of variance s^2 has the mean spectrum ``s^2 / every`` times ``|R|^2`` at the loop's rate. A sine
of the deviation comes out at its own frequency and, weaker, at its images ``w + 2 pi l / T``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import reference_transition, tracker_gain
from micromanip.settings.schema.reference import Tracker

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SHOWN = np.array([1.0, 0.0, 0.0, 1.0, 0.0])
"""What a sample shows of the state: position and oscillation."""


@dataclass(frozen=True)
class Tracking:
    """The predictor of `tracker`; a sample every `every` cycles of `period_s`, seen `latency_s` after it was taken."""

    tracker: Tracker
    every: int
    latency_s: float
    period_s: float

    @cached_property
    def _gain(self) -> Array:
        return tracker_gain(self.tracker)

    @property
    def _omega(self) -> float:
        return 2.0 * math.pi * self.tracker.oscillation_Hz

    def response(self, taken: Array, omega: Array) -> Complex:
        """R (n,) at `omega` (n,) rad/s; `taken` (5,) is the row G."""
        turn = np.exp(-1j * omega * self.period_s)
        ages = self.latency_s + self.period_s * np.arange(self.every)
        if not self.tracker.predict:
            return np.asarray(taken[0] * (turn[:, None] ** np.arange(self.every)).sum(axis=1))
        rows = np.array([taken @ reference_transition(self._omega, age) for age in ages])
        given = (turn[:, None] ** np.arange(self.every)) @ rows
        step = reference_transition(self._omega, self.every * self.period_s)
        gain = self._gain
        kept = (np.eye(5) - np.outer(gain, _SHOWN)) @ step
        poles, vectors = np.linalg.eig(kept)
        entering = np.linalg.solve(vectors, gain.astype(complex))
        state = vectors @ (entering[:, None] / (1.0 - poles[:, None] * turn[None, :] ** self.every))
        return np.asarray(np.einsum("ni,in->n", given, state))

    def images(self, hertz: float) -> Array:
        """Frequencies (k,), Hz, from minus to plus half of the loop's rate, of a sine of `hertz`; its own comes first."""
        rate, sampled = 1.0 / self.period_s, 1.0 / (self.every * self.period_s)
        away = np.arange(-self.every, self.every + 1)
        found = hertz + sampled * away[np.argsort(np.abs(away), kind="stable")]
        return np.asarray(found[(found > -0.5 * rate) & (found <= 0.5 * rate)])

    def given(self, times_s: Array, samples: Array, cycles_s: Array, taken: Array) -> Array:
        """What the outer loop is given (n,) in the cycles at `cycles_s` (n,) of `samples` (k,), taken at `times_s` (k,).

        A sample counts from `latency_s` after it was taken. The predictor starts at rest at the first.
        """
        place = np.searchsorted(times_s + self.latency_s, cycles_s + 1e-3 * self.period_s, side="right") - 1
        if not self.tracker.predict:
            return np.asarray(taken[0] * samples[np.maximum(place, 0)])
        gain, state = self._gain, np.zeros((len(samples), 5))
        state[0, 0] = samples[0]
        gaps = np.diff(times_s)
        steps = {gap: reference_transition(self._omega, gap) for gap in np.unique(np.round(gaps, 9))}
        for k, gap in enumerate(np.round(gaps, 9), start=1):
            expected = steps[gap] @ state[k - 1]
            state[k] = expected + gain * (samples[k] - _SHOWN @ expected)
        at = state[np.maximum(place, 0)]
        tau = cycles_s - times_s[np.maximum(place, 0)]
        w = self._omega
        turned = (np.cos(w * tau) * at[:, 3] + np.sin(w * tau) / w * at[:, 4], np.cos(w * tau) * at[:, 4] - w * np.sin(w * tau) * at[:, 3])  # fmt: skip
        moved = (at[:, 0] + tau * (at[:, 1] + 0.5 * tau * at[:, 2]), at[:, 1] + tau * at[:, 2], at[:, 2])
        return np.asarray(sum(factor * part for factor, part in zip(taken, (*moved, *turned), strict=True)))
