"""The reference: own sources, and a tracker's signal predicted to now."""

import math

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.linalg import block_diag

from micromanip.control.predictor import output_row, reference_transition, tracker_gain
from micromanip.rt.laws.reference import (
    MAX_MODES,
    REFERENCE_PARAMETERS,
    REFERENCE_STATE,
    REFERENCE_STATES,
    SAMPLES,
    SIGNAL,
    SINES,
    extrapolate,
    own_reference,
    previewed,
    signal_reference,
    signal_sample,
)
from micromanip.settings.schema.reference import AxisTracker, Oscillation, Tracker

from .builders import record

NO_SAMPLES = np.zeros((1, 3))
NO_MOTION = [0.0] * (REFERENCE_STATES - 1)
MS = 1_000_000
STILL = record(REFERENCE_STATE)


def own(p, t_s, samples=NO_SAMPLES):
    w = np.full(REFERENCE_STATES, np.nan)
    own_reference(p, w, t_s, samples)
    return w


# -- what is known ahead ----------------------------------------------------------------------------


@given(st.floats(-0.5, 2.0), st.floats(0.1, 200.0), st.floats(-180.0, 180.0))
def test_a_sine_is_known_ahead_as_it_will_be(t_s, frequency_Hz, phase_deg):
    p = record(
        REFERENCE_PARAMETERS,
        kind=SINES,
        offset_um=70.0,
        sines=1,
        amplitude_um=[30.0],
        omega=[2 * np.pi * frequency_Hz],
        phase=[math.radians(phase_deg)],
    )
    s = record(REFERENCE_STATE)
    now = s["w"].copy()
    assert previewed(p, s, t_s, NO_SAMPLES) == own(p, t_s)[0]
    assert s["w"].tolist() == now.tolist()  # the reference of now is another thing


# -- extrapolation ----------------------------------------------------------------------------------


def swinging(*modes):
    """Parameters of oscillations of (rad/s, decay)."""
    omegas, decays = ([each[i] for each in modes] for i in (0, 1))
    return record(REFERENCE_PARAMETERS, modes=len(modes), oscillator=omegas, decay=decays)


MODES = st.lists(st.tuples(st.floats(10.0, 500.0), st.sampled_from([0.0, 0.3, 20.0])), max_size=MAX_MODES)
STATES = st.lists(st.floats(-100.0, 100.0), min_size=REFERENCE_STATES, max_size=REFERENCE_STATES)


@given(STATES, MODES, st.floats(-0.02, 0.02))
def test_extrapolation_is_the_differential_equation(w, modes, tau_s):
    w, out, used = np.array(w), np.full(REFERENCE_STATES, np.nan), 3 + 2 * len(modes)
    extrapolate(swinging(*modes), STILL["detuning"], w, tau_s, out)

    def slope(_, x):
        turned = [(x[i + 1] - d * x[i], -omega * omega * x[i] - d * x[i + 1]) for i, (omega, d) in parts]
        return [x[1], x[2], 0.0, *(value for pair in turned for value in pair)]

    parts = list(zip(range(3, used, 2), modes, strict=True))
    fine = solve_ivp(slope, (0.0, tau_s), w[:used], rtol=1e-10, atol=1e-10).y[:, -1] if tau_s else w[:used]
    assert out[:used] == pytest.approx(fine, rel=1e-6, abs=1e-5)
    assert np.isnan(out[used:]).all(), "what it has not is not touched"


# -- own sources --------------------------------------------------------------------------------------


SINES_25 = record(
    REFERENCE_PARAMETERS,
    kind=SINES,
    offset_um=70.0,
    start_s=0.5,
    sines=2,
    amplitude_um=[30.0, 5.0],
    omega=[2 * math.pi * 10.0, 2 * math.pi * 3.0],
    phase=[0.0, 1.0],
)


def test_sines_are_equation_25_and_begin_without_a_step():
    assert own(SINES_25, 0.4).tolist() == [70.0, *NO_MOTION]
    assert own(SINES_25, 0.5)[0] == pytest.approx(70.0)
    t = 0.6137
    expected = 70.0 + 30.0 * math.sin(20 * math.pi * (t - 0.5))
    expected += 5.0 * (math.sin(6 * math.pi * (t - 0.5) + 1.0) - math.sin(1.0))
    assert own(SINES_25, t)[0] == pytest.approx(expected)


PLAYED = np.column_stack([np.zeros(5), [1.0, 3.0, 7.0, 8.0, 6.0], np.zeros(5)])
PLAYER = record(REFERENCE_PARAMETERS, kind=SAMPLES, column=1, samples_per_s=1000.0)


@pytest.mark.parametrize(("t_s", "expected"), [(0.0, 1.0), (0.001, 3.0), (0.0024, 7.0), (0.0026, 8.0), (0.004, 6.0)])
def test_samples_are_played_one_by_one(t_s, expected):
    assert own(PLAYER, t_s, PLAYED)[0] == expected


@pytest.mark.parametrize(("t_s", "place"), [(-1.0, 1.0), (-0.0011, 1.0), (0.0052, 6.0), (3600.0, 6.0)])
def test_before_and_after_the_samples_it_stands_still(t_s, place):
    """A held position has no velocity: fed forward it would be a lasting error."""
    assert own(PLAYER, t_s, PLAYED).tolist() == [place, *NO_MOTION]


# -- signal -------------------------------------------------------------------------------------------

SETTINGS = Tracker(source="signal", sample_rate_Hz=1000.0, oscillation_Hz=8.0, noise_um=0.5).of("x")
OMEGA = 2 * math.pi * 8.0


def tracker(**fields):
    defaults = {
        "kind": SIGNAL,
        "predict": 1,
        "modes": 1,
        "oscillator": [OMEGA],
        "gain": tracker_gain(SETTINGS),
        "horizon_s": 0.02,
        "horizon_cycles": 200,
        "low_um": -300.0,
        "high_um": 300.0,
        "jump_um": math.inf,
    }
    return record(REFERENCE_PARAMETERS, **{**defaults, **fields})


def path(t):
    return 130.0 * np.sin(2 * np.pi * 0.11 * t) + 30.0 * np.sin(OMEGA * t + 0.3)


THREE = AxisTracker(
    sample_rate_Hz=500.0,
    oscillations=(
        Oscillation(frequency_Hz=7.5, um_per_s=4.0),
        Oscillation(frequency_Hz=0.9, um_per_s=9.0, decay_per_s=0.5),
        Oscillation(frequency_Hz=21.0, um_per_s=2.0, decay_per_s=3.0),
    ),
    jerk_um_per_s3=900.0,
    noise_um=0.4,
)


def test_three_oscillations_are_filterpys_too():
    kf, h = KalmanFilter(dim_x=9, dim_z=1), 2e-3
    kf.F = reference_transition(THREE.oscillations, h)
    kf.H = output_row(9)[None, :]
    walked = [
        o.um_per_s**2 * quad(lambda t, d=o.decay_per_s: math.exp(-2 * d * t), 0.0, h)[0] for o in THREE.oscillations
    ]
    turns = [
        w * np.diag([1.0, (2 * np.pi * o.frequency_Hz) ** 2]) for w, o in zip(walked, THREE.oscillations, strict=True)
    ]
    kf.Q = block_diag(Q_continuous_white_noise(3, dt=h, spectral_density=THREE.jerk_um_per_s3**2), *turns)
    kf.R = np.array([[THREE.noise_um**2]])
    kf.P = np.diag([1.0, 1e2, 1e4, 1.0, 1e2, 1.0, 1e2, 1.0, 1e2])
    for _ in range(5_000):
        kf.predict()
        kf.update(np.zeros(1))
    assert tracker_gain(THREE) == pytest.approx(kf.K[:, 0], rel=1e-4)
    omegas = [2 * np.pi * o.frequency_Hz for o in THREE.oscillations]
    p = tracker(modes=3, oscillator=omegas, decay=[0.0, 0.5, 3.0], gain=tracker_gain(THREE))
    rng, s = np.random.default_rng(6), record(REFERENCE_STATE)
    for k in range(1, 200):
        y = path(k * h) + 0.4 * rng.normal()
        signal_sample(p, s, y, 2 * k * MS)
        if k == 1:
            kf.x = np.zeros((9, 1))
            kf.x[0] = y
        else:
            kf.predict()
            kf.update(np.array([y]))
        assert s["filtered"] == pytest.approx(kf.x[:, 0], rel=1e-3, abs=1e-3 * max(1.0, np.abs(kf.x).max()))


def test_it_predicts_to_now():
    """Latency of 1 ms and samples every ms: held, the reference is micrometres late; predicted, hardly."""
    errors = {}
    for predict in (0, 1):
        p, s, error = tracker(predict=predict), record(REFERENCE_STATE), []
        for k in range(1, 10_000):
            now = k * MS // 10
            if k % 10 == 0:
                signal_sample(p, s, path(now * 1e-9 - 1e-3), now - MS)
            signal_reference(p, s, now)
            error.append(path(now * 1e-9) - s["w"][0] - s["w"][3])
        errors[predict] = np.std(error[5000:])
    assert errors[0] > 1.0
    assert errors[1] < 0.1 * errors[0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 300.001, -301.0])
def test_bad_samples_are_rejected_and_counted(value):
    p, s = tracker(), record(REFERENCE_STATE)
    for k in range(1, 5):
        signal_sample(p, s, 10.0 * k, k * MS)
    before = s.copy()
    signal_sample(p, s, value, 5 * MS)
    assert s["rejected"] == 1
    s["rejected"] = 0
    assert s == before


def test_past_the_horizon_the_last_position_is_held():
    p, s = tracker(), record(REFERENCE_STATE)
    for k in range(1, 100):
        signal_sample(p, s, 2.0 * k, k * MS)
    signal_reference(p, s, 99 * MS + 20 * MS)
    assert s["w"][0] + s["w"][3] > 220.0  # still extrapolated: 2 um a ms
    s["silent"] = 201
    signal_reference(p, s, 99 * MS + 20 * MS + 1)
    assert s["w"].tolist() == [198.0, *NO_MOTION]


def test_after_a_gap_it_starts_anew():
    p, s = tracker(), record(REFERENCE_STATE)
    for k in range(1, 100):
        signal_sample(p, s, 2.0 * k, k * MS)
    s["silent"] = 210
    signal_sample(p, s, -50.0, 99 * MS + 21 * MS)
    assert s["filtered"].tolist() == [-50.0, *NO_MOTION]
    signal_reference(p, s, 121 * MS)
    assert s["w"][0] == -50.0


@pytest.mark.parametrize("silent", [7, 50_000])
@pytest.mark.parametrize("gap_ms", [1, 5, 21, 100, 5000])
@pytest.mark.parametrize("predict", [0, 1])
def test_a_jump_is_not_believed_while_it_is_followed(gap_ms, predict, silent):
    """However long the signal was away, or the loop stood still, and however long it stays there."""
    p, s = tracker(jump_um=50.0, predict=predict), record(REFERENCE_STATE)
    for k in range(1, 100):
        signal_sample(p, s, 10.0, k * MS)
    s["silent"] = silent
    for k in range(100 + gap_ms, 1000 + gap_ms):
        signal_sample(p, s, 70.0, k * MS, True)
        signal_reference(p, s, k * MS)
        assert s["w"][0] + s["w"][3] == pytest.approx(10.0, abs=1e-6)
    assert s["rejected"] == 900
    assert s["silent"] == silent  # nobody tells it anything: the watch goes on counting


@pytest.mark.parametrize("gap_ms", [21, 100, 5000])
def test_after_an_outage_a_place_within_reach_is_believed(gap_ms):
    p, s = tracker(jump_um=50.0), record(REFERENCE_STATE)
    for k in range(1, 100):
        signal_sample(p, s, 10.0, k * MS)
    s["silent"] = 10 * gap_ms
    signal_sample(p, s, 59.0, (99 + gap_ms) * MS)
    assert (s["silent"], s["rejected"], s["filtered"][0]) == (0, 0, 59.0)


@pytest.mark.parametrize(
    ("gap_ms", "silent", "believed"),
    [(15, 150, True), (40, 10, True), (40, 200, True), (40, 201, False), (101, 10, False)],
)
def test_a_loop_that_stood_still_believes_what_went_on_meanwhile(gap_ms, silent, believed):
    """1.5 um a ms: what moved 50 um in a gap was lost for good, whether the signal or the loop had been away."""
    p, s = tracker(jump_um=40.0), record(REFERENCE_STATE)
    for k in range(1, 200):
        signal_sample(p, s, 1.5 * k - 290.0, k * MS)
    s["silent"] = silent
    value_um = s["sampled_um"] + 1.5 * gap_ms
    signal_sample(p, s, value_um, (199 + gap_ms) * MS, True)
    assert (s["sampled_um"] == value_um, s["rejected"] == 0) == (believed, believed)


def test_one_that_wanders_back_after_it_was_doubted_for_long_is_lost_all_the_same():
    p, s = tracker(jump_um=50.0), record(REFERENCE_STATE)
    for k in range(1, 100):
        signal_sample(p, s, 10.0, k * MS)
    s["silent"] = 7
    for k in range(100, 300):
        signal_sample(p, s, 70.0 if k < 200 else 30.0, k * MS, True)
    assert (s["silent"], s["rejected"], s["sampled_um"]) == (7, 200, 10.0)


def test_at_rest_a_tracker_may_be_set_up_anew():
    p, s = tracker(jump_um=50.0), record(REFERENCE_STATE)
    for k in range(1, 100):
        signal_sample(p, s, 10.0, k * MS)
    for k in range(100, 130):
        s["silent"] += 10
        signal_sample(p, s, 170.0, k * MS)
    assert s["sampled_um"] == 170.0
    assert s["rejected"] == 20  # as long as it was expected elsewhere


@pytest.mark.parametrize("state", range(5))
def test_a_lost_memory_starts_anew_with_the_next_sample(state):
    p, s = tracker(), record(REFERENCE_STATE)
    for k in range(1, 10):
        signal_sample(p, s, 2.0 * k, k * MS)
    s["filtered"][state] = math.nan
    signal_sample(p, s, 20.0, 10 * MS)
    assert s["filtered"].tolist() == [20.0, *NO_MOTION]


@pytest.mark.parametrize("late_ns", [0, MS // 2, 3 * MS])
def test_a_sample_out_of_order_is_ignored(late_ns):
    """Held or predicted: what is older than the newest sample says nothing about now."""
    p, s = tracker(), record(REFERENCE_STATE)
    for k in range(1, 10):
        signal_sample(p, s, 2.0 * k, k * MS)
    before = s.copy()
    signal_sample(p, s, 77.0, 9 * MS - late_ns)
    assert s == before


@given(st.lists(st.tuples(st.floats(allow_nan=True, allow_infinity=True), st.integers(-5 * MS, 30 * MS)), max_size=60))
def test_nothing_makes_it_not_finite(samples):
    p, s, now = tracker(), record(REFERENCE_STATE), 100 * MS
    for value, gap in samples:
        now += abs(gap)
        signal_sample(p, s, value, now - 5 * MS + gap // 8)
        signal_reference(p, s, now)
        assert np.isfinite(s["w"]).all()
        assert np.isfinite(s["filtered"]).all()
        assert -300.0 <= s["sampled_um"] <= 300.0
