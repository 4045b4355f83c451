"""The model of a deviation: its likelihood beside a dense Gaussian, known processes found again, honest refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from micromanip.control.joints import joints_radius
from micromanip.control.predictor import output_row, reference_transition, sample_transition, tracker_gain
from micromanip.design.identify.tracker.fit import fit_deviation, followed
from micromanip.design.identify.tracker.innovations import Whitening, log_likelihood
from micromanip.errors import CheckFailed
from micromanip.settings.schema.reference import AxisDeviation, AxisTracker, Oscillation

SWINGING = Oscillation(frequency_Hz=6.0, um_per_s=15.0, decay_per_s=4.0)
T_S = np.arange(10_000) * 1e-3


def _path(hertz, seed=0):
    """Slow path and a joint's oscillation at `hertz`, seen with .5 um of noise."""
    rng = np.random.default_rng(seed)
    lines = ((130.0, 0.11), (60.0, 0.29), (30.0, hertz))
    path = sum(a * np.sin(2 * np.pi * (f * T_S + rng.uniform())) for a, f in lines)
    return path + rng.normal(0.0, 0.5, len(T_S))


@pytest.fixture(scope="module")
def found():
    return fit_deviation(_path(7.76), 1000.0)


def test_the_likelihood_is_that_of_a_dense_gaussian():
    """Of one decaying oscillation, stationary, without a path that walks: ratios between models, not the constant."""
    rate_Hz, n = 100.0, 400
    lags = np.arange(n) / rate_Hz

    def covariance(model):
        each = model.oscillations[0]
        r = each.um_per_s**2 / (2 * each.decay_per_s) * np.exp(-each.decay_per_s * lags)
        row = r * np.cos(2 * np.pi * each.frequency_Hz * lags)
        return row[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))] + model.noise_um**2 * np.eye(n)

    models = [
        AxisTracker(rate_Hz, (SWINGING.model_copy(update=other),), 1e-3, noise_um)
        for other, noise_um in (({}, 0.5), ({"frequency_Hz": 6.4}, 0.5), ({"um_per_s": 9.0}, 0.5), ({}, 0.8))
    ]
    samples = np.random.default_rng(2).multivariate_normal(np.zeros(n), covariance(models[0]))
    dense = [multivariate_normal(np.zeros(n), covariance(model)).logpdf(samples) for model in models]
    ours = [log_likelihood(model, samples) for model in models]
    assert np.ptp(dense) > 10.0, "the models differ"
    assert np.diff(ours) == pytest.approx(np.diff(dense), abs=0.05 * np.ptp(dense))
    assert np.argsort(ours).tolist() == np.argsort(dense).tolist()


@pytest.mark.parametrize(("returns_Hz", "close"), [(0.0, 1e-6), (0.7, 5e-3)])
def test_the_innovations_are_the_stepped_filters(returns_Hz, close):
    """As the loop's law steps it, after the start is forgotten."""
    swings = (SWINGING, Oscillation(frequency_Hz=0.9, um_per_s=300.0))
    model = AxisTracker(500.0, swings, 3000.0, 0.4, returns_Hz=returns_Hz)
    samples = np.cumsum(np.random.default_rng(3).normal(size=6000))
    F, gain = sample_transition(model, 2e-3), tracker_gain(model)
    state, seen, stepped = np.zeros(len(gain)), output_row(len(gain)), []
    for sample in samples:
        state = F @ state
        stepped.append(sample - seen @ state)
        state = state + gain * stepped[-1]
    found = Whitening.of(model).innovations(samples)
    assert found[5000:] == pytest.approx(np.array(stepped[5000:]), abs=close * np.std(stepped))


def test_a_sine_is_found_to_what_its_samples_can_say(found):
    """Noise and, within some Cramer-Rao bounds, frequency; the innovations are white, of the stated variance."""
    fastest = max(found.model.oscillations, key=lambda each: each.frequency_Hz)
    least = np.sqrt(6.0) * 0.5 / (np.pi * 30.0 * 10.0 * np.sqrt(len(T_S)))
    assert fastest.frequency_Hz == pytest.approx(7.76, abs=20.0 * least)
    assert found.model.noise_um == pytest.approx(0.5, rel=0.08)
    assert found.amplitudes_um[found.model.oscillations.index(fastest)] == pytest.approx(30.0, rel=0.03)
    low, high = found.held_out.nis_bounds
    assert low <= found.held_out.nis <= high
    assert found.held_out.white


def test_frequencies_that_may_move_make_a_filter_that_bears_it():
    samples, moved = _path(7.76), _path(7.76 * 1.02, seed=8)
    models = [fit_deviation(samples, 1000.0, percent).model for percent in (0.0, 2.0)]
    at_home, away = ([np.var(Whitening.of(model).innovations(each)) for model in models] for each in (samples, moved))
    assert at_home[0] < at_home[1]
    assert away[1] < away[0]


def test_a_frequency_that_may_move_is_followed(found):
    """As far as no other could find the same one; slow motion that swings is none that is followed far."""
    model = found.model
    assert max(each.range_percent for each in model.oscillations) >= 25.0
    assert joints_radius(model) ** model.sample_rate_Hz < np.exp(-0.9)
    told = AxisDeviation.model_validate(found.settings())
    assert [each.range_percent for each in told.oscillations] == [each.range_percent for each in model.oscillations]
    fixed = fit_deviation(_path(7.76), 1000.0, moves_percent=0.0)
    assert all("range_percent" not in each for each in fixed.settings()["oscillations"])


def test_beside_it_a_narrow_one_is_what_leaves_least_where_nothing_moves(found):
    """On another draw, against narrow ones of other figures; and it is written."""
    steady, another = found.model.steady, _path(7.76, seed=5)

    def left(**other):
        sure = replace(found.model, steady=steady.model_copy(update=other)).sure
        return float(np.var(Whitening.of(sure).innovations(another)))

    assert left() < np.var(Whitening.of(found.model).innovations(another))
    for factor in (0.3, 3.0):
        assert left() < left(jerk_um_per_s3=factor * steady.jerk_um_per_s3)
    told = AxisDeviation.model_validate(found.settings()).steady
    assert told.jerk_um_per_s3 == pytest.approx(steady.jerk_um_per_s3, rel=0.01)
    assert told.returns_Hz == pytest.approx(steady.returns_Hz, rel=0.01)
    assert "steady" not in fit_deviation(_path(7.76), 1000.0, moves_percent=0.0).settings()


def test_what_a_filter_does_not_bear_is_not_followed_so_far():
    """Wide filters side by side, of a slow tracker."""
    swinging = tuple(Oscillation(frequency_Hz=each, um_per_s=200.0, range_percent=60.0) for each in (8.3, 52.0))
    wide = AxisTracker(200.0, swinging, 1e5, 0.5)
    assert joints_radius(wide) > 1.0
    assert joints_radius(followed(wide)) ** 200.0 < np.exp(-0.9)


@pytest.mark.long
def test_a_process_that_its_class_describes_is_found_again():
    rate_Hz, rng = 250.0, np.random.default_rng(11)
    F = reference_transition((SWINGING,), 1 / rate_Hz)[3:, 3:]
    state, samples = np.zeros(2), np.zeros(10_000)
    walked = SWINGING.um_per_s * np.sqrt(-np.expm1(-2 * SWINGING.decay_per_s / rate_Hz) / (2 * SWINGING.decay_per_s))
    kicks = rng.normal(size=(len(samples), 2)) * walked * np.array([1.0, 2 * np.pi * SWINGING.frequency_Hz])
    for k, kick in enumerate(kicks):
        state = F @ state + kick
        samples[k] = state[0] + 0.3 * rng.normal()
    found = fit_deviation(samples, rate_Hz, moves_percent=0.0)
    assert len(found.model.oscillations) == 1
    each = found.model.oscillations[0]
    assert each.frequency_Hz == pytest.approx(6.0, abs=0.25)
    assert each.um_per_s == pytest.approx(15.0, rel=0.15)
    assert each.decay_per_s == pytest.approx(4.0, rel=0.5)
    assert found.model.noise_um == pytest.approx(0.3, rel=0.1)
    assert found.fitted.white


def test_noise_alone_has_no_oscillation():
    found = fit_deviation(np.random.default_rng(4).normal(0.0, 0.7, 4000), 400.0)
    assert found.model.oscillations == ()
    assert found.model.noise_um == pytest.approx(0.7, rel=0.03)


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (np.zeros(500), "too few"),
        (np.random.default_rng(1).normal(size=2000), "too few"),
        (np.full(5000, 3.0), "stand still"),
        (np.where(np.arange(5000) == 77, np.nan, T_S[:5000]), "gaps"),
    ],
)
def test_what_can_not_be_fitted_is_refused(samples, said):
    with pytest.raises(CheckFailed, match=said):
        fit_deviation(samples, 1000.0)
