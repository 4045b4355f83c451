"""The model of one axis' deviation that its samples make most likely: noise, jerk, and up to three oscillations.

Oscillations are added one by one, each begun at the frequency at which it helps most, and all parameters fitted to the
first part of the record by least squares of the innovations (``innovations.py``: the maximum of their likelihood). One
more is believed where the part held out becomes more likely by a margin, and the fitted part by Schwarz' criterion. The
chosen model is fitted to all samples in the end.

A walk of ``b s sqrt(2 h)`` gives an oscillation's filter the bandwidth b (noise s, h between samples, b small beside
the rate). A sine that was seen for some seconds looks as if it never changed; a filter that believes so takes for ever
to settle, and is lost when the robot moves its joints. So b is at least what settles in a third of a second, and at
least so much that a frequency off by `moves_percent` costs no more than needed: ``b h s^2`` of the noise
comes through, and the filter lags by ``(A dw / b)^2 / 2`` behind an amplitude A whose frequency is off by dw; together
they are least at ``b^3 = A^2 dw^2 / (h s^2)``. The other parameters are fitted anew beside these walks.

A frequency that may move at all is followed (``rt/laws/frequency_lock.py``), as far as no two could find the same one.
Then `moves_percent` is what the filter bears until it is found, and a narrow one beside it has what is likeliest while
nothing moves (``predictor.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import periodogram

from micromanip.control.joints import joints_radius
from micromanip.control.predictor import output_row, reference_transition, tracker_gain
from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.rt.laws.reference import MAX_MODES
from micromanip.settings.schema.reference import AxisTracker, Oscillation, Steady

from .innovations import Whiteness, Whitening, judge_innovations, noise_of, steady_of, with_noise
from .recorded import MOVES_PERCENT

_LEAST_S, _LEAST = 3.0, 600
_BAND_HZ, _THINNED_HZ = 30.0, 240.0
"""Oscillations are looked for up to the one; for that, means of neighbouring samples at no less than the other do."""
_LEAST_TURNS, _FITTED = 4.0, 0.7
"""Turns of an oscillation that must be seen; share of the samples that is fitted to while others are held out."""
_MARGIN = 5.0
"""Log-likelihood that an oscillation must add on what was held out."""
_APART = 0.1
"""Nearer than this share of its frequency to another it is the same one once more."""
_SETTLING_PER_S = 3.0
"""Least bandwidth (rad/s) of an oscillation's filter: it begins anew after every gap in the samples."""
_SLOWEST_POLE_PER_S = 1.0
"""An oscillation that path and jerk nearly explain, a slow one, is refused where the filter would settle slower."""
_CANDIDATES, _BEGUN_SHARE, _CALMER = 10, 0.2, (1.0, 0.03)
"""Frequencies at which an oscillation is begun; the bandwidth in terms of one; the jerk in terms of that without it."""
_LOG_JERK, _LOG_WALK = (np.log(1e-3), np.log(1e7)), np.log(1e5)
"""In terms of the noise."""
_SLOWEST_PER_S, _FASTEST_PER_S = 1e-3, 30.0
_SETTLING = 0.1
"""Bandwidth of a filter that is to see an amplitude, in terms of its frequency."""
_RANGES_PERCENT, _HALF_WAY_PERCENT = (50.0, 25.0, 12.0, 6.0, 3.0), 98.0
"""How far frequencies are followed, if the filter bears it; beside another one, so much of half the way to it."""


@dataclass(frozen=True)
class Deviation:
    """What the samples of an axis say: the model, its amplitudes (um), whether innovations are as stated."""

    model: AxisTracker
    amplitudes_um: tuple[float, ...]
    fitted: Whiteness
    held_out: Whiteness
    seconds: float
    notes: tuple[str, ...] = ()

    def settings(self) -> dict[str, Any]:
        """The keys of this axis in the section ``reference.axes``, to as many digits as are known."""
        return {
            "oscillations": [
                {
                    "frequency_Hz": float(f"{each.frequency_Hz:.5g}"),
                    "um_per_s": float(f"{each.um_per_s:.3g}"),
                    **({"decay_per_s": float(f"{each.decay_per_s:.3g}")} if each.decay_per_s > 0.0 else {}),
                    **({"range_percent": each.range_percent} if each.range_percent > 0.0 else {}),
                }
                for each in self.model.oscillations
            ],
            "jerk_um_per_s3": float(f"{self.model.jerk_um_per_s3:.3g}"),
            "noise_um": float(f"{self.model.noise_um:.3g}"),
            **({} if self.model.steady is None else {"steady": _told(self.model.steady)}),
        }


def fit_deviation(samples: Array, rate_Hz: float, moves_percent: float = MOVES_PERCENT) -> Deviation:
    """The model of `samples` (n,), um, `rate_Hz` a second; `moves_percent` is by how much
    frequencies may be others afterwards until they are found; with 0 they are not looked for.

    Raises CheckFailed where the samples are too few, not finite, or show nothing.
    """
    _judge(samples, rate_Hz)
    thin = max(1, int(rate_Hz / _THINNED_HZ))
    count = len(samples) // thin
    means = np.asarray(samples[: count * thin].reshape(count, thin).mean(axis=1))
    search = _Search(means - means.mean(), rate_Hz / thin)
    found = search.chosen()
    model = search.fitted(found, count)
    amplitudes: tuple[float, ...] = ()
    if model.oscillations:
        model = with_noise(model, noise_of(model, Whitening.of(model).innovations(means)))
        amplitudes = amplitudes_of(model, means)
        moving = with_noise(_loosened(model, amplitudes, moves_percent), 1.0)
        model = search.fitted(moving, count, [o.um_per_s for o in moving.oscillations])
    model = _at_rate(model, rate_Hz, thin)
    notes: tuple[str, ...] = ()
    known = int(_FITTED * len(samples))
    early = _at_rate(found, rate_Hz, thin)
    innovations = Whitening.of(early).innovations(samples, known)
    early = with_noise(early, noise_of(early, innovations[:known]))
    held_out = judge_innovations(innovations[known:], Whitening.of(early).variance_um2)
    innovations = Whitening.of(model).innovations(samples)
    model = with_noise(model, noise_of(model, innovations))
    fitted = judge_innovations(innovations, Whitening.of(model).variance_um2)
    model = _lasting(model, len(samples) / rate_Hz)
    if moves_percent > 0.0:
        model = followed(model)
        model = replace(model, steady=steady_of(_at_rate(model, rate_Hz / thin, 1.0 / thin), means))
    if not fitted.white:
        notes = (
            f"the innovations are not white: {fitted.correlation:+.3f} at lag {fitted.lag}, at most "
            f"{fitted.correlation_bound:.3f} would be chance",
        )
    return Deviation(model, amplitudes, fitted, held_out, len(samples) / rate_Hz, notes)


def _told(steady: Steady) -> dict[str, float]:
    return {name: float(f"{value:.3g}") for name, value in steady.model_dump(exclude_none=True).items()}


def _judge(samples: Array, rate_Hz: float) -> None:
    seconds = len(samples) / rate_Hz
    if seconds < _LEAST_S or len(samples) < _LEAST:
        raise CheckFailed(
            f"{len(samples)} samples in {seconds:.3g} s are too few for a model of the deviation: it needs "
            f"{_LEAST_S:g} s and {_LEAST} samples"
        )
    if not np.isfinite(samples).all():
        raise CheckFailed("the samples of the deviation have gaps: a model needs them evenly spaced")
    if float(np.ptp(np.diff(samples, 4))) == 0.0:
        raise CheckFailed("the samples of the deviation stand still, without any noise: is the tracker connected?")


def _at_rate(model: AxisTracker, rate_Hz: float, thin: float) -> AxisTracker:
    """The same process seen at another rate, `thin` times as often: the noise of a mean is that much smaller."""
    return replace(model, sample_rate_Hz=rate_Hz, noise_um=float(model.noise_um * np.sqrt(thin)))


def amplitudes_of(model: AxisTracker, samples: Array) -> tuple[float, ...]:
    """Amplitudes (um, rms) of the oscillations in `samples` (n,), as a filter that settles in it sees them."""
    settling = _SETTLING * np.pi * np.sqrt(8.0 / model.sample_rate_Hz) * model.noise_um
    quick = tuple(
        o.model_copy(update={"um_per_s": max(o.um_per_s, float(settling * o.frequency_Hz))}) for o in model.oscillations
    )
    model = replace(model, oscillations=quick)
    gain, F = tracker_gain(model), reference_transition(model.oscillations, 1.0 / model.sample_rate_Hz)
    seen, state, swung = output_row(len(gain)), np.zeros(len(gain)), np.zeros(len(model.oscillations))
    state[0] = samples[0]
    omegas = np.array([2.0 * np.pi * o.frequency_Hz for o in model.oscillations])
    settled = len(samples) // 4
    for k, sample in enumerate(samples):
        state = F @ state
        state = state + gain * (sample - seen @ state)
        if k >= settled:
            swung += state[3::2] ** 2 + (state[4::2] / omegas) ** 2
    return tuple(float(a) for a in np.sqrt(swung / (len(samples) - settled)))


def _lasting(model: AxisTracker, seconds: float) -> AxisTracker:
    """`model`; what would take longer to die away than was looked at does not."""
    swinging = tuple(
        o.model_copy(update={"decay_per_s": 0.0 if o.decay_per_s * seconds < 1.0 else o.decay_per_s})
        for o in model.oscillations
    )
    return replace(model, oscillations=swinging)


def _loosened(model: AxisTracker, amplitudes_um: Sequence[float], moves_percent: float) -> AxisTracker:
    step_s, swinging = 1.0 / model.sample_rate_Hz, []
    for each, amplitude in zip(model.oscillations, amplitudes_um, strict=True):
        off = 0.01 * moves_percent * 2.0 * np.pi * each.frequency_Hz
        bandwidth = (amplitude**2 * off**2 / (step_s * model.noise_um**2)) ** (1.0 / 3.0)
        least = bandwidth * model.noise_um * np.sqrt(2.0 * step_s)
        swinging.append(each.model_copy(update={"um_per_s": max(each.um_per_s, float(least))}))
    return replace(model, oscillations=tuple(swinging))


def followed(model: AxisTracker) -> AxisTracker:
    """`model` with the widest ranges of its frequencies in which two never meet, and the filter forgets fast enough."""
    for most_percent in _RANGES_PERCENT:
        ranged = replace(model, oscillations=tuple(_ranged(model, most_percent)))
        if -np.log(joints_radius(ranged)) * model.sample_rate_Hz >= _SLOWEST_POLE_PER_S:
            return ranged
    return replace(model, oscillations=tuple(_ranged(model, 0.0)))


def _ranged(model: AxisTracker, most_percent: float) -> Iterator[Oscillation]:
    for each in model.oscillations:
        ratios = [other.frequency_Hz / each.frequency_Hz for other in model.oscillations if other is not each]
        apart = min((max(ratio, 1.0 / ratio) for ratio in ratios), default=np.inf)
        reach = min(most_percent, _HALF_WAY_PERCENT * float(np.sqrt(apart) - 1.0))
        yield each.model_copy(update={"range_percent": float(f"{reach:.3g}")})


class _Search:
    """Models of `samples` (n,) at `rate_Hz`, all of noise 1: the number of oscillations, then their parameters."""

    def __init__(self, samples: Array, rate_Hz: float) -> None:
        self._samples, self._rate = samples, rate_Hz
        self._seconds = len(samples) / rate_Hz
        self._known = int(_FITTED * len(samples))
        self._lowest = _LEAST_TURNS * rate_Hz / self._known
        self._highest = min(_BAND_HZ, 0.2 * rate_Hz)

    def chosen(self) -> AxisTracker:
        """The model with as many oscillations as are believed, fitted to the first part."""
        rest = AxisTracker(self._rate, (), 1e3, 1.0)
        best = self.fitted(rest, self._known)
        score = self._score(best)
        for _ in range(MAX_MODES):
            more = self.fitted(self._begun(best), self._known)
            better = self._score(more)
            swinging, apart = more.oscillations[-1], _APART * more.oscillations[-1].frequency_Hz
            if better[0] - score[0] < 1.5 * np.log(self._known) or better[1] - score[1] < _MARGIN:
                break
            if swinging.decay_per_s > 2.0 * np.pi * swinging.frequency_Hz:
                break
            if Whitening.of(more).settles_per_s(self._rate) < _SLOWEST_POLE_PER_S:
                break
            if any(abs(each.frequency_Hz - swinging.frequency_Hz) < apart for each in more.oscillations[:-1]):
                break
            best, score = more, better
        return best

    def fitted(self, model: AxisTracker, known: int, walks: Sequence[float] | None = None) -> AxisTracker:
        """`model` with the parameters that leave the least of the first `known` samples, begun at its own.

        Its oscillations walk at least as fast as `walks`, or as a filter does that settles in time.
        """
        samples = self._samples[:known]
        slowest = _SETTLING_PER_S * np.sqrt(2.0 / self._rate)
        start, low, high = self._vector(model, [slowest] * len(model.oscillations) if walks is None else walks)

        def left(x: Array) -> Array:
            return Whitening.of(self._model(x)).innovations(samples) / scale

        scale = 1.0
        scale = float(np.sqrt(np.mean(left(start) ** 2)))
        found = least_squares(left, start, bounds=(low, high), x_scale="jac", ftol=1e-5, xtol=1e-5, max_nfev=15)
        return self._model(np.asarray(found.x))

    def _score(self, model: AxisTracker) -> tuple[float, float]:
        """Log-likelihoods of the fitted part and of what was held out, but for a constant."""
        whitening = Whitening.of(model)
        e, n = whitening.innovations(self._samples, self._known), self._known
        noise2 = float(np.mean(e[:n] ** 2))
        rest = e[n:]
        return -0.5 * n * np.log(noise2), -0.5 * float(len(rest) * np.log(noise2) + np.sum(rest**2) / noise2)

    def _begun(self, model: AxisTracker) -> AxisTracker:
        """`model` with one more oscillation, at the frequency that leaves least."""
        samples = self._samples[: self._known]
        hertz, power = periodogram(Whitening.of(model).innovations(samples), self._rate, "hann")
        inside = (hertz > self._lowest) & (hertz < self._highest)
        loudest = hertz[inside][np.argsort(power[inside])[-3:]]
        tried = [*np.geomspace(self._lowest, self._highest, _CANDIDATES), *loudest]
        candidates: list[tuple[float, int, AxisTracker]] = []
        for frequency in tried:
            walk = _BEGUN_SHARE * 2.0 * np.pi * frequency * np.sqrt(2.0 / self._rate)
            more = Oscillation(frequency_Hz=float(frequency), um_per_s=float(walk), decay_per_s=0.1)
            for calmer in _CALMER:
                candidate = replace(
                    model,
                    oscillations=(*model.oscillations, more),
                    jerk_um_per_s3=max(1e-2, calmer * model.jerk_um_per_s3),
                )
                left = Whitening.of(candidate).innovations(samples)
                candidates.append((float(np.sum(left**2)), len(candidates), candidate))
        return min(candidates)[2]

    def _vector(self, model: AxisTracker, walks: Sequence[float]) -> tuple[Array, Array, Array]:
        """Parameters and their bounds: logarithms, and frequencies in turns over the record."""
        rows = [(np.log(model.jerk_um_per_s3), *_LOG_JERK)]
        turns = self._seconds * np.array([self._lowest, self._highest])
        for each, walk in zip(model.oscillations, walks, strict=True):
            rows += [
                (each.frequency_Hz * self._seconds, *turns),
                (np.log(each.um_per_s), np.log(walk), _LOG_WALK),
                (np.log(max(each.decay_per_s, 2.0 * _SLOWEST_PER_S)), np.log(_SLOWEST_PER_S), np.log(_FASTEST_PER_S)),
            ]
        start, low, high = np.array(rows).T
        return np.clip(start, low + 1e-6, high - 1e-6), low, high

    def _model(self, x: Array) -> AxisTracker:
        swinging = tuple(
            Oscillation(
                frequency_Hz=float(turns / self._seconds),
                um_per_s=float(np.exp(walk)),
                decay_per_s=float(np.exp(decay)),
            )
            for turns, walk, decay in x[1:].reshape(-1, 3)
        )
        return AxisTracker(self._rate, swinging, float(np.exp(x[0])), 1.0)
