"""A narrow predictor beside the wide one: what it gains where nothing moves, and that it costs nothing elsewhere."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from micromanip.control.predictor import output_row, sample_transition, tracker_gain
from micromanip.rt.laws.predictor import ANEW_NATS, FAR_SIGMA, LOST_NATS, SURE_NATS, extrapolate, position
from micromanip.rt.laws.reference import (
    REFERENCE_PARAMETERS,
    REFERENCE_STATE,
    REFERENCE_STATES,
    change_modes,
    signal_sample,
)
from micromanip.settings.compile.reference import fill_predictor
from micromanip.settings.schema.reference import AxisTracker, Oscillation, Steady

from .builders import record
from .kernels import predictor_course

RATE_HZ, STEP_NS, NOISE_UM, AFTER_NS = 1000.0, 1_000_000, 0.5, 1_500_000
SLOW = ((130.0, 0.11), (60.0, 0.29), (30.0, 0.83))
MODEL = AxisTracker(
    RATE_HZ,
    (Oscillation(frequency_Hz=8.0, um_per_s=3.3, range_percent=50.0),),
    1300.0,
    NOISE_UM,
    steady=Steady(jerk_um_per_s3=540.0, returns_Hz=0.65),
)


def predictor(steady=True):
    p = record(REFERENCE_PARAMETERS, horizon_s=0.02, horizon_cycles=200, low_um=-1e3, high_um=1e3, jump_um=math.inf)
    fill_predictor(p, MODEL)
    p["steady"] = steady
    return p


BOTH, WIDE, OTHER = predictor(), predictor(steady=False), predictor()
OTHER["steady_gain"][0] *= 1.1

# -- beside the wide predictor ----------------------------------------------------------------------


def errors(swing, seconds=8.0, seed=1, slow=None):
    """Errors (n,), um, of both and of the wide one alone; `swing` tells (um, Hz) of the joint at times (n,)."""
    count = round(seconds * RATE_HZ)
    fine_s = np.arange(2 * count + 4) * 0.5 / RATE_HZ
    um, hertz = swing(fine_s)
    path = um * np.sin(2 * np.pi * np.cumsum(np.broadcast_to(hertz, fine_s.shape)) * 0.5 / RATE_HZ)
    if slow is None:
        path = path + sum(a * np.sin(2 * np.pi * f * fine_s + 1.1 * f) for a, f in SLOW)
    else:
        path = path + slow(fine_s)
    samples = path[::2][:count] + np.random.default_rng(seed).normal(0.0, NOISE_UM, count)
    found = []
    for p in (BOTH, WIDE):
        given_um, detunings = np.zeros(count), np.zeros((count, 1))
        predictor_course(p, record(REFERENCE_STATE), samples, STEP_NS, AFTER_NS, given_um, detunings)
        found.append(path[3::2][:count] - given_um)
    return found


def rms(error_um, first_s, last_s):
    return float(np.sqrt(np.mean(error_um[round(first_s * RATE_HZ) : round(last_s * RATE_HZ)] ** 2)))


@pytest.mark.many_cycles
@pytest.mark.parametrize("hertz", [8.0, 6.4, 11.0])
def test_where_nothing_moves_two_thirds_are_left(hertz):
    both, wide = errors(lambda t: (30.0, hertz))
    assert rms(both, 4, 8) < 0.67 * rms(wide, 4, 8)


@pytest.mark.many_cycles
@pytest.mark.parametrize(
    ("swing", "first_s", "last_s"),
    [
        pytest.param(lambda t: (0.0, 8.0), 0.5, 8, id="none"),
        pytest.param(lambda t: (30.0, np.where(t < 4, 8.0, 8.8)), 4, 6, id="jumps by 10 %"),
        pytest.param(lambda t: (30.0, np.where(t < 4, 8.0, 10.4)), 4, 6, id="jumps by 30 %"),
        pytest.param(lambda t: (30.0, np.interp(t, [2, 3], [8, 12])), 2, 4, id="sweeps"),
        pytest.param(lambda t: (30.0, 8.0 + 0.4 * np.sin(2 * np.pi * t)), 2, 8, id="swings by 5 %"),
        pytest.param(lambda t: (30.0 * (t > 4), 8.8), 4, 6, id="comes from nothing"),
        pytest.param(lambda t: (30.0 * np.exp(-3 * (t % 2)), 8.8), 2, 8, id="dies away"),
        pytest.param(lambda t: (30.0, 12.0), 0.05, 1, id="first second"),
        pytest.param(lambda t: (20.0, 8.0 + 4.0 * np.sin(60.0 * t)), 2, 8, id="two as one"),
    ],
)
def test_where_something_moves_it_is_as_good_as_the_wide_one(swing, first_s, last_s):
    both, wide = errors(swing)
    assert rms(both, first_s, last_s) <= 1.005 * rms(wide, first_s, last_s)


@pytest.mark.many_cycles
def test_nothing_steps_where_the_one_takes_over_from_the_other():
    """Of what is given a sample corrects no more, at the most, than of the wide one, where a joint jumps, too."""
    count = 8000
    time_s = np.arange(count) / RATE_HZ
    hertz = np.where(time_s < 4.0, 8.0, 9.0)
    path = 30.0 * np.sin(2 * np.pi * np.cumsum(hertz) / RATE_HZ)
    samples = path + np.random.default_rng(5).normal(0.0, NOISE_UM, count)
    steps = []
    for p in (BOTH, WIDE):
        s, expected, corrected = record(REFERENCE_STATE), np.zeros(REFERENCE_STATES), np.zeros(count)
        for k, sample in enumerate(samples):
            extrapolate(p, s["detuning"], s["filtered"], 1e-3, expected)
            signal_sample(p, s, sample, (k + 1) * STEP_NS)
            corrected[k] = position(s["filtered"]) - position(expected)
        steps.append(np.abs(corrected[100:]).max())
    assert steps[0] <= 1.05 * steps[1]


# -- the law ----------------------------------------------------------------------------------------

ANY = st.lists(st.tuples(st.floats(-300.0, 300.0), st.integers(1, 15_000_000)), min_size=1, max_size=60)
LIKELY = st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=80)


@given(ANY)
def test_the_wide_one_knows_nothing_of_the_other(samples):
    """To the last bit."""
    states, now_ns = (record(REFERENCE_STATE), record(REFERENCE_STATE)), 1
    for value_um, gap_ns in samples:
        now_ns += gap_ns
        for p, s in zip((BOTH, WIDE), states, strict=True):
            signal_sample(p, s, value_um, now_ns)
    assert states[0]["wide"].tolist() == states[1]["filtered"].tolist()
    assert states[0]["wide_detuning"].tolist() == states[1]["detuning"].tolist()


@given(ANY, LIKELY)
def test_what_is_given_lies_between_both(samples, likely):
    s, now_ns = record(REFERENCE_STATE), 1
    for value_um, gap_ns in [*samples, *((each, STEP_NS) for each in likely)]:
        now_ns += gap_ns
        signal_sample(BOTH, s, value_um, now_ns)
        assert LOST_NATS < s["trust"] <= SURE_NATS
        for mixed, wide, narrow in (("filtered", "wide", "narrow"), ("detuning", "wide_detuning", "narrow_detuning")):
            low, high = np.minimum(s[wide], s[narrow]), np.maximum(s[wide], s[narrow])
            room = 1e-12 * (1.0 + np.abs(high) + np.abs(low))
            assert (low - room <= s[mixed]).all()
            assert (s[mixed] <= high + room).all()


def test_the_narrow_one_is_the_kalman_filter_of_what_is_surely_known():
    sure, h = MODEL.sure, 1e-3
    kf = KalmanFilter(dim_x=5, dim_z=1)
    kf.F, kf.H, kf.R = sample_transition(sure, h), output_row(5)[None, :], [[NOISE_UM**2]]
    jerk = np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]])
    omega, walk = 2 * np.pi * 8.0, sure.oscillations[0].um_per_s
    kf.Q = np.zeros((5, 5))
    kf.Q[:3, :3], kf.Q[3:, 3:] = 540.0**2 * jerk, walk**2 * h * np.diag([1.0, omega**2])
    kf.P = np.diag([1.0, 1e3, 1e6, 1.0, 1e3])
    for _ in range(8000):
        kf.predict()
        kf.update(0.0)
    assert tracker_gain(sure) == pytest.approx(kf.K[:, 0], rel=1e-3)
    assert BOTH["steady_um2"] == pytest.approx(kf.S[0, 0], rel=1e-3)
    kf.x = np.array([[3.0], [20.0], [100.0], [10.0], [30.0]])
    p = BOTH.copy()
    p["detuning_low"] = p["detuning_high"] = 0.0
    s = record(REFERENCE_STATE, wide=kf.x[:, 0], narrow=kf.x[:, 0], trust=SURE_NATS, time_ns=STEP_NS)
    for k in range(200):
        kf.predict()
        value_um = float(kf.x[0, 0] + kf.x[3, 0] + 0.4 * math.sin(0.7 * k))
        kf.update(value_um)
        signal_sample(p, s, value_um, (k + 2) * STEP_NS)
        assert s["narrow"][:5] == pytest.approx(kf.x[:, 0], rel=1e-2, abs=1e-2)


@pytest.mark.parametrize("spoilt", ["far", "lost", "memory"])
def test_where_the_narrow_one_is_lost_it_begins_where_the_wide_one_is(spoilt):
    s = record(REFERENCE_STATE, wide=[10.0], narrow=[10.0], trust=SURE_NATS, time_ns=STEP_NS)
    sigma = math.sqrt(BOTH["steady_um2"])
    if spoilt == "lost":
        s["trust"], s["narrow"][0] = LOST_NATS + 0.1, 10.0 + sigma
    else:
        s["narrow"][0] = math.nan if spoilt == "memory" else 10.0 + 1.01 * FAR_SIGMA * sigma
    signal_sample(BOTH, s, 10.0, 2 * STEP_NS)
    assert s["narrow"].tolist() == s["wide"].tolist() == s["filtered"].tolist()
    assert s["trust"] == ANEW_NATS


@pytest.mark.parametrize(("old", "new"), [(WIDE, BOTH), (OTHER, BOTH)])
def test_under_other_parameters_all_go_on_from_what_was_given(old, new):
    s = record(REFERENCE_STATE, filtered=[5.0, 1.0], wide=[4.0], narrow=[6.0], detuning=[2.0], trust=SURE_NATS)
    change_modes(old, new, s)
    assert s["filtered"].tolist()[:2] == [5.0, 1.0]
    assert s["wide"].tolist() == s["narrow"].tolist() == s["filtered"].tolist()
    assert s["wide_detuning"].tolist() == s["narrow_detuning"].tolist() == s["detuning"].tolist()
    assert s["trust"] == ANEW_NATS
