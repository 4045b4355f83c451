"""The notch before the PID: its response, what it can't do whatever comes, and its changes without a bump."""

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from micromanip.control.pid import pid_gains, pid_response
from micromanip.rt.laws.pid import PID_PARAMETERS, pid_output, retune, start_pid
from micromanip.settings.schema.axis import Inner, Notch

from .builders import PERIOD_S, courses, pid_state, record
from .kernels import notch_course, pid_course

ERRORS = st.floats(-50.0, 50.0)
ANCHOR = Inner(mode="pid", K_V_per_um=0.6, Ti_ms=0.571, Td_ms=0.167, filter_ms=0.3)


def settings(frequency_Hz=66.0, width_Hz=20.0, depth_percent=95.0):
    return ANCHOR.model_copy(
        update={"notch": Notch(frequency_Hz=frequency_Hz, width_Hz=width_Hz, depth_percent=depth_percent)}
    )


def parameters(inner, period_s=PERIOD_S):
    return record(PID_PARAMETERS, **asdict(pid_gains(inner, period_s)))


@st.composite
def notches(draw, rate_Hz=1.0 / PERIOD_S):
    """Of any width and depth, anywhere below what the rate shows."""
    centre = rate_Hz * draw(st.floats(1e-4, 0.44))
    return settings(centre, centre * draw(st.floats(0.01, 3.0)), draw(st.floats(1.0, 100.0)))


def along(p, x, periods=1, s=None):
    out = np.zeros(len(x))
    steps = np.broadcast_to(periods, len(x)).astype(np.int64)
    notch_course(p, pid_state() if s is None else s, np.asarray(x, dtype=float), steps, out)
    return out


def measured(p, omega, step_s, periods=1):
    """Frequency response over `omega`, from the impulse response."""
    impulse = np.zeros(round(0.5 / step_s))
    impulse[0] = 1.0
    out = along(p, impulse, periods)
    return np.exp(-1j * np.outer(omega * step_s, np.arange(len(out)))) @ out


def closed_form(frequency_Hz, width_Hz, share, step_s):
    """(s^2 + (1 - share) k w s + w^2) / (s^2 + k w s + w^2) by the bilinear transform, warped at its centre."""
    w, k = 2.0 / step_s * np.tan(np.pi * frequency_Hz * step_s), width_Hz / frequency_Hz
    return signal.bilinear([1.0, (1.0 - share) * k * w, w * w], [1.0, k * w, w * w], fs=1.0 / step_s)


@pytest.mark.parametrize(("rate_Hz", "periods"), [(10_000.0, 1), (20_000.0, 1), (2_000.0, 1), (10_000.0, 10)])
@pytest.mark.parametrize(("width_Hz", "depth_percent"), [(20.0, 95.0), (60.0, 100.0), (10.0, 50.0)])
def test_the_response_is_that_of_the_closed_form(rate_Hz, periods, width_Hz, depth_percent):
    step_s = periods / rate_Hz
    omega = 2 * np.pi * np.array([0.5, 20.0, 55.0, 66.0, 80.0, 200.0, 0.4 / step_s])
    b, a = closed_form(66.0, width_Hz, 0.01 * depth_percent, step_s)
    expected = signal.freqz(b, a, omega * step_s)[1]
    inner = settings(66.0, width_Hz, depth_percent)
    assert measured(parameters(inner, 1.0 / rate_Hz), omega, step_s, periods) == pytest.approx(expected, abs=1e-6)
    in_design = pid_response(inner, step_s, omega) / pid_response(ANCHOR, step_s, omega)
    assert in_design == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("rate_Hz", [1_000.0, 10_000.0])
def test_a_narrow_one_of_full_depth_is_scipys(rate_Hz):
    omega = 2 * np.pi * np.array([1.0, 40.0, 63.0, 66.0, 70.0, 300.0])
    b, a = signal.iirnotch(66.0, 66.0 / 12.0, rate_Hz)
    p = parameters(settings(66.0, 12.0, 100.0), 1.0 / rate_Hz)
    expected = signal.freqz(b, a, omega / rate_Hz)[1]
    assert measured(p, omega, 1.0 / rate_Hz) == pytest.approx(expected, abs=0.02)  # it warps the width, too


@given(notches(), st.integers(1, 4))
def test_its_centre_is_exact_and_rest_passes(inner, periods):
    p, step_s = parameters(inner), periods * PERIOD_S
    centre = inner.notch.frequency_Hz
    if centre * step_s > 0.45:
        return
    slow = parameters(inner, step_s)
    for each, steps in ((p, periods), (slow, 1)):  # a step of several cycles is a step of one slower notch
        s = pid_state()
        start_pid(each, s, 7.0, 0.0)
        assert along(each, np.full(50, 7.0), steps, s) == pytest.approx(np.full(50, 7.0))
    omega = np.array([2 * np.pi * centre])
    gain = pid_response(inner, step_s, omega) / pid_response(ANCHOR, step_s, omega)
    assert gain == pytest.approx(1.0 - 0.01 * inner.notch.depth_percent, abs=1e-9)


@given(notches(), courses(ERRORS, most=200), st.data())
def test_its_output_is_bounded_whatever_the_steps(inner, x, data):
    """Samples that come late, or not at all for long, included."""
    steps = data.draw(st.lists(st.integers(1, 3000), min_size=len(x), max_size=len(x)))
    out = along(parameters(inner), x, np.array(steps))
    assert np.isfinite(out).all()
    assert np.abs(out).max() <= 5.0 * np.abs(x).max() + 1e-9


@given(courses(ERRORS))
def test_without_one_the_pid_is_the_plain_pid(error):
    plain, none = np.zeros(len(error)), np.zeros(len(error))
    fields = {name: value for name, value in asdict(pid_gains(ANCHOR, PERIOD_S)).items() if "notch" not in name}
    states = [pid_state(), pid_state()]
    for p, s, out in zip((record(PID_PARAMETERS, **fields), parameters(ANCHOR)), states, (plain, none), strict=True):
        pid_course(p, s, error, 1, out)
    assert plain.tolist() == none.tolist()
    assert states[0].tobytes() == states[1].tobytes()


@given(courses(ERRORS), st.one_of(st.just(ANCHOR), notches()), st.one_of(st.just(ANCHOR), notches()))
def test_switched_on_off_or_changed_it_makes_no_bump(error, before, after):
    """At the last error again the output goes on by the integral and by what the derivative loses, no more."""
    old, new, s = parameters(before), parameters(after), pid_state()
    out = np.zeros(len(error))
    pid_course(old, s, error, 1, out)
    derivative = s["derivative"]
    retune(old, new, s)
    went_on = pid_output(new, s, error[-1], 1) - out[-1]
    moved = abs(new["integral"] * error[-1]) + abs(derivative)
    if before == after:  # its states are kept: nothing is new but what the same notch does to the same error
        moved += 2.0 * new["K_V_per_um"] * 50.0 + new["derivative"] / PERIOD_S * 100.0
    assert abs(went_on) <= moved + 1e-9
