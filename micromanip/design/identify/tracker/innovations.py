"""Innovations of a tracker's samples under a model of the deviation, and the likelihood that they give.

The stationary filter's innovations are the samples behind zeros at the model's poles z and poles at the filter's own p,

    e = prod (1 - z_i / q) / prod (1 - p_i / q) y,   z = eig F,   p = eig (I - g H) F

(innovations form; Ljung, System Identification, section 4.3). In sections of second order that is exact to rounding
even for slow oscillations. What is not known of the state at the beginning decays with the same p: least squares
takes it away. Where all intensities are told in terms of the noise, the noise itself is what the innovations say,
``s^2 = mean e^2 / v`` with their variance v for a noise of 1, and the likelihood is a function of ``mean e^2`` alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import sosfilt
from scipy.stats import chi2, norm

from micromanip.control.joints import joints_radius
from micromanip.control.predictor import output_row, sample_transition, stationary
from micromanip.control.system import Array
from micromanip.settings.schema.reference import AxisTracker, Steady

# NIS is the mean of ``e^2 / v``: n times it has a chi-square distribution of n degrees (Bar-Shalom, Li and Kirubarajan,
# Estimation with Applications to Tracking and Navigation, section 5.4). The autocorrelations of white innovations are
# normal with variance 1/n; the largest of several lags is held against a bound for all of them together (Bonferroni).

_WRONGLY = 0.01
"""How often good innovations are refused, each way."""
_LAGS = 20


@dataclass(frozen=True)
class Whiteness:
    """NIS with its bounds, and the largest autocorrelation of lags 1 to 20 with its bound."""

    nis: float
    nis_bounds: tuple[float, float]
    correlation: float
    lag: int
    correlation_bound: float

    @property
    def white(self) -> bool:
        """Whether none of the lags stands out."""
        return abs(self.correlation) <= self.correlation_bound


def judge_innovations(innovations: Array, variance_um2: float) -> Whiteness:
    """Of innovations (n,), um, whose variance is stated as `variance_um2`; n above 20."""
    n = len(innovations)
    power = float(np.sum(innovations**2))
    lags = np.array([float(innovations[k:] @ innovations[:-k]) for k in range(1, _LAGS + 1)]) / power
    worst = int(np.argmax(np.abs(lags)))
    low, high = (chi2.ppf(share, n) / n for share in (0.5 * _WRONGLY, 1.0 - 0.5 * _WRONGLY))
    bound = float(norm.ppf(1.0 - 0.5 * _WRONGLY / _LAGS) / np.sqrt(n))
    return Whiteness(power / n / variance_um2, (float(low), float(high)), float(lags[worst]), worst + 1, bound)


@dataclass(frozen=True)
class Whitening:
    """The filter that leaves innovations of samples, for `model`; raises as `stationary` where it has none."""

    sections: Array
    poles: NDArray[np.complex128]
    variance_um2: float
    """Of the innovations, as the model states it."""

    @classmethod
    def of(cls, model: AxisTracker) -> Whitening:
        """From the predictor's gain."""
        gain, variance, _ = stationary(model)
        step_s = 1.0 / model.sample_rate_Hz
        step = sample_transition(model, step_s)
        poles = np.linalg.eigvals((np.eye(len(gain)) - np.outer(gain, output_row(len(gain)))) @ step).astype(complex)
        turns = [np.exp((-o.decay_per_s + 2j * np.pi * o.frequency_Hz) * step_s) for o in model.oscillations]
        # the path's own: at rest, or of what the acceleration goes against the rate by in a step
        half = np.pi * model.returns_Hz * step_s
        turn = 1.0 - 2.0 * half**2 + 2j * half * np.sqrt(1.0 - half**2)
        path = [1.0, turn, np.conj(turn)] if half > 0.0 else [1.0, 1.0, 1.0]
        zeros = np.array([*path, *turns, *np.conj(turns)], dtype=complex)
        return cls(np.hstack([_sections(zeros), _sections(poles)]), poles, variance)

    def settles_per_s(self, rate_Hz: float) -> float:
        """How fast the filter forgets how it began, at its slowest (1/s), with `rate_Hz` samples a second."""
        return float(-np.log(np.abs(self.poles).max()) * rate_Hz)

    def innovations(self, samples: Array, known: int | None = None) -> Array:
        """Innovations (n,), um, of evenly spaced `samples` (n,); the first `known` tell the state at the start."""
        known = len(samples) if known is None else known
        whole = np.asarray(sosfilt(self.sections, samples))
        upper = self.poles[self.poles.imag >= 0.0]
        answers = np.exp(np.arange(len(samples))[:, None] * np.log(upper)[None, :])
        basis = np.hstack([answers.real, answers.imag[:, upper.imag > 0.0]])
        begun = np.linalg.lstsq(basis[:known], whole[:known], rcond=None)[0]
        return np.asarray(whole - basis @ begun)


def _sections(roots: NDArray[np.complex128]) -> Array:
    """Polynomials (k, 3) of second order with these `roots`, an odd number with their conjugates; the last of first.

    By frequency, so that zeros and poles that nearly cancel stand together.
    """
    upper = np.sort_complex(roots[roots.imag > 0.0])[::-1]
    real = np.sort(roots.real[roots.imag == 0.0])[::-1]
    pairs = [(2.0 * root.real, abs(root) ** 2) for root in sorted(upper, key=np.angle)]
    pairs = [(a + b, a * b) for a, b in zip(real[0:-1:2], real[1::2], strict=True)] + pairs
    return np.array([[1.0, -total, product] for total, product in pairs] + [[1.0, -real[-1], 0.0]])


def with_noise(model: AxisTracker, noise_um: float) -> AxisTracker:
    """`model` with another noise, all else in the same proportion to it: its gain stays."""
    factor = noise_um / model.noise_um
    swinging = tuple(o.model_copy(update={"um_per_s": factor * o.um_per_s}) for o in model.oscillations)
    steady = model.steady
    if steady is not None and steady.jerk_um_per_s3 is not None:
        steady = steady.model_copy(update={"jerk_um_per_s3": factor * steady.jerk_um_per_s3})
    jerk = factor * model.jerk_um_per_s3
    return replace(model, noise_um=noise_um, jerk_um_per_s3=jerk, oscillations=swinging, steady=steady)


def noise_of(model: AxisTracker, innovations: Array) -> float:
    """The noise (um) for which the stated variance is that of `innovations` (n,), by the likelihood's maximum."""
    stated = Whitening.of(model).variance_um2
    return float(model.noise_um * np.sqrt(np.mean(innovations**2) / stated))


def log_likelihood(model: AxisTracker, samples: Array) -> float:
    """Gaussian log-likelihood of `samples` (n,), of the stationary filter, the state at the start at its best."""
    whitening = Whitening.of(model)
    e, variance = whitening.innovations(samples), whitening.variance_um2
    return float(-0.5 * (len(e) * np.log(2.0 * np.pi * variance) + np.sum(e**2) / variance))


# Beside walks that bear another pose part of the path is taken for an oscillation that changes, and the jerk that is
# likeliest is that of both. The narrow predictor (``rt/laws/predictor.py``) has walks of its own, so jerk and the slow
# frequency at which the path returns are those that leave least of the innovations beside these (``innovations.py``:
# the maximum of their likelihood), all else being as it was fitted.

_BEGUN_Hz, _LOWEST_Hz, _HIGHEST_SHARE = 0.3, 0.02, 0.25
"""Slow frequency at which the search begins; the lowest one, by which no path returns within a record; no higher than
this share of the slowest oscillation's, which would take part of it over."""
_CALMEST = 1e-3
"""Least jerk, in terms of that of the wide predictor."""


def steady_of(model: AxisTracker, samples: Array) -> Steady | None:
    """What is likeliest of evenly spaced `samples` (n,) beside `model`, their own; None where there is nothing to gain.

    That is so without oscillations, and where the narrow predictor would not bear the ranges of their frequencies.
    """
    if not model.oscillations:
        return None
    highest = _HIGHEST_SHARE * min(each.frequency_Hz for each in model.oscillations)
    low = np.log([_CALMEST * model.jerk_um_per_s3, _LOWEST_Hz])
    high = np.log([model.jerk_um_per_s3, max(highest, 2.0 * _LOWEST_Hz)])

    def described(x: Array) -> Steady:
        return Steady(jerk_um_per_s3=float(np.exp(x[0])), returns_Hz=float(np.exp(x[1])))

    def left(x: Array) -> Array:
        sure = replace(model, steady=described(x)).sure
        assert sure is not None
        return Whitening.of(sure).innovations(samples) / model.noise_um

    start = np.log([0.5 * model.jerk_um_per_s3, min(_BEGUN_Hz, highest)])
    start = np.clip(start, low + 1e-6, high - 1e-6)
    found = least_squares(left, start, bounds=(low, high), ftol=1e-6, xtol=1e-4, max_nfev=30)
    steady = described(np.asarray(found.x))
    sure = replace(model, steady=steady).sure
    return steady if sure is not None and joints_radius(sure) < 1.0 else None
