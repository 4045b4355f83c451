"""Joints that swing at another frequency than was said, beside filters that were told the right one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.control.joints import joints_radius, removed
from micromanip.control.predictor import output_row, reference_transition, tracker_gain
from micromanip.rt.laws.frequency_lock import follow_joints
from micromanip.rt.laws.reference import (
    REFERENCE_PARAMETERS,
    REFERENCE_STATE,
    REFERENCE_STATES,
    change_modes,
    extrapolate,
    position,
    signal_reference,
    signal_sample,
)
from micromanip.settings.compile.reference import fill_predictor
from micromanip.settings.schema.reference import AxisTracker, Oscillation

from .builders import record
from .kernels import predictor_course

RATE_HZ, STEP_NS, NOISE_UM = 1000.0, 1_000_000, 0.5
RANGE_PERCENT = 50.0
SLOW = ((130.0, 0.11), (60.0, 0.29))


def model(*hertz, range_percent=RANGE_PERCENT, um_per_s=3.3):
    swinging = (Oscillation(frequency_Hz=each, um_per_s=um_per_s, range_percent=range_percent) for each in hertz)
    return AxisTracker(RATE_HZ, tuple(swinging), 1300.0, NOISE_UM)


def predictor(*hertz, **others):
    p = record(REFERENCE_PARAMETERS, horizon_s=0.02, horizon_cycles=200, low_um=-1e3, high_um=1e3, jump_um=math.inf)
    fill_predictor(p, model(*hertz, **others))
    return p


LONE = predictor(8.0)
REACH = (LONE["detuning_low"][0], LONE["detuning_high"][0])


def taken_up(p, s, w, innovation_um):
    follow_joints(p, p["gain"], p["detuning_pull"], p["swing_floor_um2"], s["detuning"], w, innovation_um)


def path(time_s, *swings):
    """Slow motion, and (um, Hz) for each joint."""
    return sum(um * np.sin(2 * np.pi * hertz * time_s + 0.7 * k) for k, (um, hertz) in enumerate((*SLOW, *swings)))


def played(p, swings, seconds=4.0, noise_um=NOISE_UM, seen=None, seed=1):
    """Error (n,), um, 1.5 ms after each sample, and detunings (n, modes), Hz; only the samples `seen` come."""
    time_s = np.arange(1, round(seconds * RATE_HZ) + 1) / RATE_HZ
    samples = path(time_s, *swings) + np.random.default_rng(seed).normal(0.0, noise_um, len(time_s))
    if seen is not None:
        samples[~seen] = np.nan
    given_um, detunings = np.zeros(len(time_s)), np.zeros((len(time_s), len(p["oscillator"])))
    s = record(REFERENCE_STATE)
    predictor_course(p, s, samples, STEP_NS, 1_500_000, given_um, detunings)
    return path(time_s + 1.5e-3, *swings) - given_um, detunings[:, : p["modes"]] / (2 * np.pi)


def rms(error_um):
    return float(np.sqrt(np.mean(error_um[-2000:] ** 2)))


# -- what it finds ----------------------------------------------------------------------------------


@pytest.mark.many_cycles
@pytest.mark.parametrize("hertz", [5.6, 7.6, 8.0, 9.1, 11.9])
def test_a_sine_at_another_frequency_is_followed_as_by_the_filter_that_knew_it(hertz):
    error_um, detuning_Hz = played(LONE, [(30.0, hertz)])
    knew_um, _ = played(predictor(hertz, range_percent=0.0), [(30.0, hertz)])
    assert detuning_Hz[-1000:].mean() == pytest.approx(hertz - 8.0, abs=0.003 * hertz)
    assert rms(error_um) == pytest.approx(rms(knew_um), rel=0.06)
    if abs(hertz - 8.0) > 1.0:
        assert rms(played(predictor(8.0, range_percent=0.0), [(30.0, hertz)])[0]) > 5.0 * rms(error_um)


@pytest.mark.many_cycles
def test_a_jump_by_a_tenth_is_found_within_half_a_second():
    time_s = np.arange(1, 5001) / RATE_HZ
    phase = 2 * np.pi * np.where(time_s < 2.5, 8.0 * time_s, 8.0 * 2.5 + 8.8 * (time_s - 2.5))
    samples, given_um, detunings = 30.0 * np.sin(phase), np.zeros(5000), np.zeros((5000, 3))
    predictor_course(LONE, record(REFERENCE_STATE), samples, STEP_NS, 0, given_um, detunings)
    assert np.abs(detunings[3000:, 0] / (2 * np.pi) - 0.8).max() < 0.1


@pytest.mark.many_cycles
def test_without_a_swing_nothing_is_followed_and_it_costs_nothing():
    error_um, detuning_Hz = played(LONE, [])
    assert rms(error_um) <= 1.02 * rms(played(predictor(8.0, range_percent=0.0), [])[0])
    assert np.ptp(detuning_Hz[2000:]) == 0.0


# -- the law ----------------------------------------------------------------------------------------

ANY = st.lists(st.tuples(st.floats(-300.0, 300.0), st.integers(1, 15_000_000)), min_size=1, max_size=60)


@given(ANY, st.sampled_from([(8.0,), (5.0, 8.0, 13.0)]))
def test_whatever_is_seen_it_stays_in_its_range(samples, hertz):
    p, s, now_ns = predictor(*hertz, range_percent=20.0), record(REFERENCE_STATE), 1
    for value_um, gap_ns in samples:
        now_ns += gap_ns
        before = s["detuning"].copy()
        signal_sample(p, s, value_um, now_ns)
        assert np.isfinite(s["filtered"]).all()
        assert (p["detuning_low"] <= s["detuning"]).all()
        assert (s["detuning"] <= p["detuning_high"]).all()
        assert (np.abs(s["detuning"] - before) <= p["detuning_slew"] * (1 + 1e-9)).all()


@given(ANY)
def test_switched_off_it_is_the_filter_of_the_configured_frequency(samples):
    """To the last bit, whatever else the parameters say."""
    plain, off = predictor(8.0, range_percent=0.0), LONE.copy()
    off["detuning_low"] = off["detuning_high"] = 0.0
    states, now_ns = (record(REFERENCE_STATE), record(REFERENCE_STATE)), 1
    for value_um, gap_ns in samples:
        now_ns += gap_ns
        for p, s in zip((plain, off), states, strict=True):
            signal_sample(p, s, value_um, now_ns)
            signal_reference(p, s, now_ns + 1_300_000)
    assert states[0] == states[1]
    assert (states[1]["detuning"] == 0.0).all()


@given(st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=2), st.floats(-40.0, 40.0))
def test_where_the_frequency_changes_nothing_steps(o, innovation_um):
    """At the sample's own time the two are the same; only how they go on is another."""
    states = []
    for p in (LONE, predictor(8.0, range_percent=0.0)):
        s = record(REFERENCE_STATE, filtered=[3.0, 20.0, 100.0, o[0], 50.0 * o[1]], time_ns=STEP_NS)
        p["predict"] = 1
        expected = np.zeros(REFERENCE_STATES)
        extrapolate(p, s["detuning"], s["filtered"], 1e-3, expected)
        signal_sample(p, s, position(expected) + innovation_um, 2 * STEP_NS)
        signal_reference(p, s, 2 * STEP_NS)
        states.append(s)
    assert states[0]["filtered"].tolist() == states[1]["filtered"].tolist()
    assert position(states[0]["w"]) == position(states[1]["w"])


@given(st.floats(0.1, 100.0), st.floats(-math.pi, math.pi), st.floats(-1e-3, 1e-3))
def test_the_lead_is_what_a_correction_turns_it_by(amplitude_um, angle, innovation_um):
    p, omega = LONE.copy(), LONE["oscillator"][0]
    p["swing_floor_um2"], p["detuning_slew"], p["detuning_pull"] = 0.0, 1e6, 1.0
    w = np.array([0.0, 0.0, 0.0, amplitude_um * math.sin(angle), amplitude_um * math.cos(angle) * omega, *[0.0] * 4])
    s, turned = record(REFERENCE_STATE), w + p["gain"] * innovation_um
    taken_up(p, s, w, innovation_um)
    lead = math.atan2(turned[3], turned[4] / omega) - angle
    lead = (lead + math.pi) % (2 * math.pi) - math.pi
    expected = max(REACH[0], min(REACH[1], lead))
    assert s["detuning"][0] == pytest.approx(expected, rel=0.02, abs=1e-9)


@pytest.mark.parametrize(
    ("hertz", "percent", "kept"), [(8.0, 50.0, 9.0), (8.4, 50.0, 9.0), (8.0, 5.0, 8.4), (8.0, 0.0, 8.0)]
)
def test_other_parameters_keep_frequency_amplitude_and_phase(hertz, percent, kept):
    s = record(REFERENCE_STATE, filtered=[0.0, 0.0, 0.0, 7.0, 300.0], detuning=[2 * np.pi])
    new = predictor(hertz, range_percent=percent)
    rate_um_per_s = 300.0 * 9.0 / 8.0
    change_modes(LONE, new, s)
    omega = new["oscillator"][0]
    assert omega + s["detuning"][0] == pytest.approx(2 * np.pi * kept)
    assert s["filtered"][3] == 7.0
    assert s["filtered"][4] / omega * 2 * np.pi * kept == pytest.approx(rate_um_per_s)


# -- its design -------------------------------------------------------------------------------------


def test_a_sample_removes_what_stepping_the_filter_says():
    own = model(8.0, um_per_s=0.3)
    F, gain, error = reference_transition(own.oscillations, 1e-3), tracker_gain(own), np.zeros(5)
    error[3], sizes = 1.0, []
    for _ in range(1200):
        error = F @ error
        error -= gain * (output_row(5) @ error)
        sizes.append(math.hypot(error[3], error[4] / (2 * np.pi * 8.0)))
    left = (sizes[-1] / sizes[-601]) ** (1 / 600)
    assert removed(own)[0] == pytest.approx(1 - left, rel=0.05)


def test_what_a_range_would_make_unstable_is_seen():
    """Two wide filters side by side, of a slow tracker, one of them on the other's place."""
    swinging = (Oscillation(frequency_Hz=f, um_per_s=200.0, range_percent=60.0) for f in (8.3, 52.0))
    wide = AxisTracker(200.0, tuple(swinging), 1e5, 0.5)
    assert joints_radius(model(8.0)) < 1.0
    assert joints_radius(wide) > 1.0
