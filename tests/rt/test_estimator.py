"""Kalman filter of one axis, against filterpy and against itself with the samples in their right places."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from micromanip.control.gain_schedule import intermittent_gains
from micromanip.rt.laws.estimator import (
    ESTIMATOR_STATE,
    GAPS,
    INPUT_HISTORY,
    output,
    predict_to,
    remember,
    start_estimator,
    update,
)

from .builders import record
from .kernels import estimator_course
from .outer_loops import designed, parameters, process_noise

SETTINGS, GAINS, P = designed()
N = len(GAINS.A)
NEVER = -1


def started(p=P, cycle=0, u=0.0, y=0.0):
    s = record(ESTIMATOR_STATE)
    start_estimator(p, s, cycle, u, y)
    return s


def along(p, s, cycles, u, y, age):
    """Estimates at `cycles`, and which samples were taken."""
    n = int(p["states"])
    out, taken = np.zeros((len(cycles), n)), np.zeros(len(cycles), np.bool_)
    estimator_course(
        p,
        s,
        np.asarray(cycles, np.int64),
        np.asarray(u, float),
        np.asarray(y, float),
        np.asarray(age, np.int64),
        out,
        taken,
    )
    return out, taken


def noisy_signals(count, seed=1):
    rng = np.random.default_rng(seed)
    return 3.0 * np.sin(0.01 * np.arange(count)) + rng.normal(size=count), rng.normal(size=count)


def filterpy_filter(settings, gains):
    """Filter that finds its gain by itself, with the covariance already stationary."""
    kf = KalmanFilter(dim_x=len(gains.A), dim_z=1, dim_u=1)
    kf.F, kf.B, kf.H = gains.A, gains.B[:, None], gains.C[None, :]
    kf.Q, kf.R = process_noise(settings, gains), np.array([[settings.sensor_noise_um**2]])
    kf.P = np.eye(len(gains.A))
    for _ in range(6000):
        for _ in range(settings.sample_cycles):
            kf.predict()
        kf.update(np.zeros(1))
    kf.x = np.zeros((len(gains.A), 1))
    return kf


@pytest.mark.parametrize("every", [1, 4, 10])
def test_against_filterpy(every):
    """A sample every `every` cycles, with the gain for that interval."""
    settings, gains, p = designed(sample_cycles=every)
    kf = filterpy_filter(settings, gains)
    assert kf.K[:, 0] == pytest.approx(gains.observer, rel=1e-4, abs=1e-6)
    count = 400
    u, y = noisy_signals(count)
    fresh = np.arange(count) % every == 0
    fresh[0] = False
    estimates, taken = along(p, started(p), np.arange(count), u, y, np.where(fresh, 0, NEVER))
    expected = np.zeros_like(estimates)
    for k in range(1, count):
        kf.predict(u=u[k - 1 : k, None])
        if fresh[k]:
            kf.update(y[k : k + 1])
        expected[k] = kf.x[:, 0]
    assert (taken == fresh).all()
    assert np.abs(expected).max() > 1.0
    assert estimates == pytest.approx(expected, rel=0, abs=1e-3 * np.abs(expected).max())
    assert estimates @ gains.C == pytest.approx(expected @ gains.C, rel=0, abs=1e-4)


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("gap", [1, 2, 3, 7, 20, GAPS, 2 * GAPS])
def test_a_sample_out_of_time_has_the_gain_of_its_gap(every, gap):
    """That of the filter which carries its covariance along; after longer gaps, that of the longest in the table."""
    settings, gains, _ = designed(sample_cycles=every)
    kf = filterpy_filter(settings, gains)
    for _ in range(min(gap, GAPS)):
        kf.predict()
    kf.update(np.zeros(1))
    table = intermittent_gains(gains, GAPS)
    assert (table[every - 1] == gains.observer).all()
    assert table[min(gap, GAPS) - 1] == pytest.approx(kf.K[:, 0], rel=1e-3, abs=1e-5)
    p = parameters(gains, gains=table)
    s = started(p)
    predict_to(p, s, gap)
    assert update(p, s, gap, 1.0)
    assert s["filtered"][: len(gains.A)] == pytest.approx(table[min(gap, GAPS) - 1])


def rerun(u, samples, now, restart=0):
    """Plain filter from cycle `restart` to `now` with the samples, by cycle, where they belong."""
    x = np.zeros(N)
    for cycle in range(restart, now + 1):
        if cycle > restart:
            x = GAINS.A @ x + GAINS.B * u[cycle - 1]
        if cycle in samples:
            x = x + GAINS.observer * (samples[cycle] - GAINS.C @ x)
    return x


@given(st.lists(st.one_of(st.just(NEVER), st.integers(0, 40)), min_size=1, max_size=60), st.integers(0, 2**32 - 1))
def test_late_samples_count_where_they_belong(ages, seed):
    count = len(ages) + 1
    u, y = noisy_signals(count, seed)
    age = np.array([NEVER, *ages])
    estimates, taken = along(P, started(), np.arange(count), u, y, age)
    samples, newest = {}, 0
    for k in range(1, count):
        belongs = k - age[k]
        useful = age[k] != NEVER and belongs > newest
        assert taken[k] == useful
        if useful:
            samples[belongs], newest = y[k], belongs
        assert estimates[k] == pytest.approx(rerun(u, samples, k), rel=1e-9, abs=1e-9)


def test_out_of_order_is_refused_and_changes_nothing():
    s = started()
    u, y = noisy_signals(20)
    along(P, s, np.arange(10), u[:10], y[:10], np.where(np.arange(10) > 0, 0, NEVER))
    predict_to(P, s, 10)
    assert update(P, s, 8, 1.0) == 0  # cycle 9 has had its sample
    before = s.copy()
    for cycle in (9, 5, 0, -3, 11, 10_000):  # the same again, older, from the future
        assert not update(P, s, cycle, 99.0)
        assert s == before
    assert update(P, s, 10, 0.5)


def test_a_sample_older_than_the_memory_is_refused():
    s = started()
    u, y = noisy_signals(2)
    along(P, s, [0, INPUT_HISTORY + 5], u, y, [NEVER, NEVER])
    before = s.copy()
    assert not update(P, s, 5, 1.0)
    assert s == before


@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_an_overrun_is_that_many_predictions_with_the_set_point_held(skipped, seed):
    u, y = noisy_signals(20, seed)
    once, many = started(), started()
    age = np.where(np.arange(20) > 0, 0, NEVER)
    for s in (once, many):
        along(P, s, np.arange(20), u, y, age)
    jumped, _ = along(P, once, [19 + skipped], [0.5], [0.0], [NEVER])
    cycles = 20 + np.arange(skipped)
    walked, _ = along(P, many, cycles, [*np.full(skipped - 1, u[-1]), 0.5], np.zeros(skipped), np.full(skipped, NEVER))
    assert (jumped[-1] == walked[-1]).all()
    # and a late sample from inside the gap still finds the set-points held there
    taken_at = 19 + (skipped + 1) // 2
    assert update(P, once, taken_at, 1.0)
    assert update(P, many, taken_at, 1.0)
    assert (once["x"] == many["x"]).all()


@pytest.mark.parametrize("jump", [False, True])
def test_after_a_gap_longer_than_the_memory_it_starts_anew(jump):
    s = started()
    u, y = noisy_signals(30)
    along(P, s, np.arange(30), u, y, np.where(np.arange(30) > 0, 0, NEVER))
    gap = INPUT_HISTORY + 50
    cycles = [29 + gap] if jump else 30 + np.arange(gap)
    along(P, s, cycles, np.full(len(cycles), 2.0), np.zeros(len(cycles)), np.full(len(cycles), NEVER))
    held = u[29] if jump else 2.0
    assert update(P, s, 29 + gap - jump - (not jump) + 0, 7.0)
    fresh = started(cycle=29 + gap, u=held, y=7.0)
    assert s["x"] == pytest.approx(fresh["x"], abs=1e-12)
    assert output(P, s["x"]) == pytest.approx(7.0, abs=1e-9)


@pytest.mark.parametrize("delay", [0, 1, 5])
@pytest.mark.parametrize("oscillation_Hz", [None, 200.0])
def test_a_steady_start_has_no_innovation(delay, oscillation_Hz):
    _, _, p = designed(delay, oscillation_Hz=oscillation_Hz)
    s = started(p, cycle=7, u=3.0, y=-11.0)
    start = s["x"].copy()
    assert output(p, start) == pytest.approx(-11.0)
    remember(s, 3.0)
    for cycle in range(8, 60):
        predict_to(p, s, cycle)
        assert update(p, s, cycle, -11.0)
        assert abs(s["innovation_um"]) < 1e-9
        remember(s, 3.0)
    assert s["x"] == pytest.approx(start, abs=1e-8)
