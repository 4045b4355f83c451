"""The tracker's predictor (``rt/laws/reference.py``) as a transfer from its samples to what the outer loop is given.

At a sample z the predictor's state is ``f+ = F(T) f + g (z - H F(T) f)``, in a cycle of age tau it gives
``w = F(tau) f``, of which the outer loop takes ``r = G w`` (``control/outer_gains.py``). T is `every` cycles h. A train
of samples of spectrum Z(w) is at the loop's rate a train of spikes, whose spectrum is the same and periodic, behind

    R(w) = sum_j e^(-i w h j) G F(tau_0 + j h) (I - (I - g H) F(T) e^(-i w T))^-1 g,   j = 0 .. every - 1

(the polyphase identity; Vaidyanathan, Multirate Systems and Filter Banks, section 4.3). Between samples no noise
enters, so white noise of variance s^2 has the mean spectrum ``s^2 / every`` times ``|R|^2`` at the loop's rate. A sine
of the deviation comes out at its own frequency and, weaker, at its images ``w + 2 pi l / T``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from micromanip.control.predictor import output_row, reference_transition, sample_transition, tracker_gain
from micromanip.control.system import Array, Complex
from micromanip.rt.jit import Compiler
from micromanip.rt.laws.predictor import ANEW_NATS, NEVER_DOUBTED_UM2, give_both, narrow_anew
from micromanip.rt.laws.reference import REFERENCE_PARAMETERS, REFERENCE_STATE, signal_reference, signal_sample
from micromanip.rt.signatures import array_of
from micromanip.settings.compile.reference import fill_predictor
from micromanip.settings.schema.reference import AxisTracker

compiled = Compiler(__file__)


@dataclass(frozen=True)
class Tracking:
    """The predictor of `tracker`; a sample every `every` cycles of `period_s`, seen `latency_s` after it was taken."""

    tracker: AxisTracker
    every: int
    latency_s: float
    period_s: float

    @cached_property
    def _acting(self) -> AxisTracker:
        """The predictor that is believed while all is as was said."""
        return self.tracker.sure or self.tracker

    @cached_property
    def _gain(self) -> Array:
        return tracker_gain(self._acting)

    def _moved(self, time_s: float) -> Array:
        return reference_transition(self.tracker.oscillations, time_s)

    def response(self, taken: Array, omega: Array) -> Complex:
        """R (n,) at `omega` (n,) rad/s; `taken` (r,) is the row G."""
        turn = np.exp(-1j * omega * self.period_s)
        ages = self.latency_s + self.period_s * np.arange(self.every)
        if not self.tracker.predict:
            return np.asarray(taken[0] * (turn[:, None] ** np.arange(self.every)).sum(axis=1))
        rows = np.array([taken @ self._moved(age) for age in ages])
        given = (turn[:, None] ** np.arange(self.every)) @ rows
        step = sample_transition(self._acting, self.every * self.period_s)
        gain = self._gain
        kept = (np.eye(len(gain)) - np.outer(gain, output_row(len(gain)))) @ step
        poles, vectors = np.linalg.eig(kept)
        entering = np.linalg.solve(vectors, gain.astype(complex))
        state = vectors @ (entering[:, None] / (1.0 - poles[:, None] * turn[None, :] ** self.every))
        return np.asarray(np.einsum("ni,in->n", given, state))

    def stepped(
        self, taken_s: Array, arrived_s: Array, samples: Array, now_s: Array, row: Array, trust: Array | None = None
    ) -> tuple[Array, Array]:
        """What the outer loop is given (n,) in the cycles at `now_s` (n,), by the same steps as the loop's.

        `samples` (k,) were taken at `taken_s` (k,) and seen from `arrived_s` (k,) on; `row` (r,) is G. The predictor
        starts at rest at the first. And after each sample the trust (k,) in the narrow predictor
        (``rt/laws/predictor.py``), which can be given: noise tells it, so that samples without any take that of those
        with it.
        """
        parameters, state = np.zeros(1, REFERENCE_PARAMETERS), np.zeros(1, REFERENCE_STATE)
        p = parameters[0]
        fill_predictor(p, self.tracker)
        p["low_um"], p["high_um"], p["jump_um"], p["horizon_s"] = -np.inf, np.inf, np.inf, np.inf
        if trust is not None:
            p["steady_um2"] = NEVER_DOUBTED_UM2
        # a sample that arrives with a cycle is there, whatever the rounding
        times_s = (taken_s, arrived_s - 1e-3 * self.period_s, now_s)
        taken_ns, arrived_ns, now_ns = (_ns(each - taken_s[0]) + 1 for each in times_s)
        out = np.empty(len(now_s))
        trusted = np.zeros(len(taken_ns)) if trust is None else trust
        values, taken = np.ascontiguousarray(samples, dtype=float), np.ascontiguousarray(row)
        _given(parameters, state, taken_ns, arrived_ns, values, now_ns, taken, trusted, trust is not None, out)
        return out, trusted


def _ns(time_s: Array) -> NDArray[np.int64]:
    return np.rint(1e9 * time_s).astype(np.int64)


_TIMES, _VALUES = types.int64[::1], types.float64[::1]
_PREDICTOR = array_of(REFERENCE_PARAMETERS), array_of(REFERENCE_STATE)
_SAMPLES = _TIMES, _TIMES, _VALUES


@compiled.entry(types.void(*_PREDICTOR, *_SAMPLES, _TIMES, _VALUES, _VALUES, types.boolean, _VALUES))
def _given(
    parameters: Any, state: Any, taken_ns: Any, arrived_ns: Any, samples: Any, now_ns: Any, row: Any, trust: Any,
    told: bool, out: Any,
) -> None:  # fmt: skip
    p, s = parameters[0], state[0]
    seen = 0
    for i in range(len(now_ns)):
        while seen < len(samples) and (seen == 0 or arrived_ns[seen] <= now_ns[i]):
            signal_sample(p, s, samples[seen], taken_ns[seen])
            if told:
                if trust[seen] == ANEW_NATS:
                    narrow_anew(s)
                s["trust"] = trust[seen]
                if p["steady"]:
                    give_both(s)
            else:
                trust[seen] = s["trust"]
            seen += 1
        signal_reference(p, s, now_ns[i])
        out[i] = 0.0
        for k in range(len(row)):
            out[i] += row[k] * s["w"][k]
